import os
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigError
from service.config.cameras import CalibrationRecord, read_camera, write_atomically, write_camera
from service.config.generators import generator_names, load_generator
from service.vision.camera import Camera, OpenCVLens, TsaiLens

CAMERA = """
name = "lens"
image_size_px = [640, 480]
pixel_pitch_mm = [0.005, 0.005]
focal_length_mm = 18.78
kappa1_per_mm2 = -0.00249
principal_point_px = [319.5, 239.5]
sx = 1.0
"""


def camera_file(folder: Path, text: str) -> Path:
    path = folder / "camera.toml"
    path.write_text(text)
    return path


def test_the_five_steam_generators_are_shipped():
    assert generator_names() == ["delta60", "model-f", "51b", "system80", "candu6"]
    for name in generator_names():
        g = load_generator(name)
        assert g.lattice.rim_radius_mm < g.lattice.outer_radius_mm < g.lattice.pitch_mm / 2


def test_a_generator_file_with_one_table_serves_as_well(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('[mine]\narrangement = "rotated-square"\npitch_mm = 20\ntube_outer_diameter_mm = 12\nwall_mm = 1\n')
    assert load_generator(str(path)).lattice.arrangement == "rotated-square"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pitch = 20", ["pitch", "missing", "pitch_mm"]),
        ("pitch_mm = -1", ["pitch_mm = -1", "above 0"]),
        ("pitch_mm = nan", ["pitch_mm", "finite"]),
        ("pitch_mm = 10", ["tube_outer_diameter_mm", "overlap"]),
        ("pitch_mm = 20\ncolour = 1", ["colour", "unknown key"]),
        ("pitch_mm = 20\nwal_mm = 1", ["wal_mm", "did you mean wall_mm"]),
    ],
)
def test_an_impossible_generator_is_refused_by_name(tmp_path, text, words):
    path = tmp_path / "mine.toml"
    path.write_text(f'[mine]\narrangement = "square"\ntube_outer_diameter_mm = 12\nwall_mm = 1\n{text}\n')
    with pytest.raises(ConfigError) as error:
        load_generator(str(path))
    for word in [str(path), *words]:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


def test_an_unknown_generator_names_the_nearest():
    with pytest.raises(ConfigError, match="did you mean system80"):
        load_generator("sistem80")


@pytest.mark.parametrize("lens", [TsaiLens(0.002), OpenCVLens((-0.2, 0.1, 0.0, 0.001, 0.0))])
def test_a_camera_file_survives_writing_and_reading(tmp_path, lens):
    camera = Camera(
        (640, 480), (0.0056, 0.0056), 8.5, lens, (312.5, 240.25), 1.002, "c",
        ("focal_length_mm", "cx_px"), np.array([[4e-4, 1e-3], [1e-3, 1.0]]),
    )  # fmt: skip
    path = tmp_path / "camera.toml"
    write_camera(path, camera, CalibrationRecord(0.04, "2026-01-01T00:00:00Z", 12))
    read = read_camera(path)
    assert read.lens == lens
    assert read.principal_point_px == camera.principal_point_px
    assert read.parameters == camera.parameters
    np.testing.assert_allclose(read.covariance, camera.covariance, rtol=1e-12)


def test_a_camera_file_may_leave_all_but_the_pixel_pitch_unknown(tmp_path):
    camera = read_camera(camera_file(tmp_path, "image_size_px = [640, 480]\npixel_pitch_mm = [0.005, 0.005]\n"))
    assert not camera.complete
    assert camera.focal_length_mm is camera.lens is camera.principal_point_px is camera.sx is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[640, 480]", "[640]", ["image_size_px", "2 numbers"]),
        ("[640, 480]", "[640.5, 480]", ["image_size_px", "whole"]),
        ("18.78", "0", ["focal_length_mm = 0", "at least 0.1"]),
        ("18.78", "1e-4", ["focal_length_mm = 0.0001", "at least 0.1"]),
        ("[0.005, 0.005]", "[5.0, 5.0]", ["pixel_pitch_mm = [5.0, 5.0]", "from 0.0001 to 1"]),
        ("[640, 480]", "[640, 1e9]", ["image_size_px", "from 16 to 65536"]),
        ("[319.5, 239.5]", "[1e9, 240]", ["principal_point_px", "640 x 480"]),
        ("-0.00249", "-2.49", ["kappa1_per_mm2 = -2.49", "from -0.75 to 0.75"]),
        ("18.78", '"long"', ["focal_length_mm", "number"]),
        ("18.78", "inf", ["focal_length_mm", "finite"]),
        ("sx = 1.0", "sx = 1.0\nopencv_distortion = [0, 0, 0, 0, 0]", ["opencv_distortion", "not both"]),
        ("sx = 1.0", "sx = 1.0\n[sigma]\nfocal = 1", ["sigma.focal", "focal_length_mm"]),
        ("sx = 1.0", 'sx = 1.0\n[covariance]\nparameters = ["sx"]\nmatrix = [[1, 2]]', ["covariance.matrix", "1 x 1"]),
        (
            "sx = 1.0",
            'sx = 1.0\n[covariance]\nparameters = ["sx"]\nmatrix = [[-1.0]]',
            ["covariance.matrix", "positive"],
        ),
        ("pixel_pitch_mm", "pixel_pich_mm", ["pixel_pitch_mm", "missing", "pixel_pich_mm"]),
        ("sx = 1.0", "sx = ", ["not valid TOML"]),
    ],
)
def test_an_impossible_camera_file_is_refused_by_name(tmp_path, old, new, words):
    path = camera_file(tmp_path, CAMERA.replace(old, new))
    with pytest.raises(ConfigError) as error:
        read_camera(path)
    for word in [str(path), *words]:
        assert word in str(error.value)


def test_what_is_no_file_is_written_to_and_never_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_atomically(pipe, "name = 1\n")
        assert os.read(reader, 99) == b"name = 1\n"
    finally:
        os.close(reader)
    assert pipe.is_fifo()
    with pytest.raises(ConfigError, match="/dev/full: cannot be written: No space left on device"):
        write_atomically(Path("/dev/full"), "name = 1\n")
    assert Path("/dev/full").is_char_device()


def test_a_link_stays_one_and_what_it_points_to_is_written(tmp_path):
    target, link = tmp_path / "camera.toml", tmp_path / "link.toml"
    target.write_text("old")
    link.symlink_to(target)
    write_atomically(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_what_cannot_be_read_or_written_is_said_in_a_line(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_camera(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="folder"):
        read_camera(tmp_path)
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="UTF-8"):
        read_camera(tmp_path / "x.toml")
    with pytest.raises(ConfigError, match="cannot be written"):
        write_camera(tmp_path / "gone" / "c.toml", Camera((640, 480), (0.005, 0.005)))
