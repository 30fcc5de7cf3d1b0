"""What the wheel carries, and that the program finds it there: the sources are not needed."""

import os
import subprocess
import sys
import zipfile

import pytest

from service import __version__
from tests.wheel.building import PATIENCE_S, ROOT, build_wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build_wheel(tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module")
def unpacked(wheel, tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


@pytest.fixture
def bowlsight(unpacked, tmp_path):
    """Run the program out of the unpacked wheel, in an empty folder."""

    def run(*arguments):
        code = (
            f"import sys; from service.cli import main; assert main.__code__.co_filename.startswith({str(unpacked)!r})"
        )
        return subprocess.run(
            [sys.executable, "-c", f"{code}; sys.exit(main())", *map(str, arguments)],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(unpacked)}, capture_output=True, text=True, check=False,
            timeout=PATIENCE_S,
        )  # fmt: skip

    return run


def test_it_is_named_by_its_version(wheel):
    assert wheel.name == f"bowlsight-{__version__}-py3-none-any.whl"


def test_every_file_of_the_configuration_travels_as_it_is(unpacked):
    files = [p for p in (ROOT / "config").rglob("*") if p.is_file()]
    assert {"station.toml", "steam_generators.toml", "bowlsight.service"} <= {p.name for p in files}
    for file in files:
        assert (
            unpacked / "service/shipped/config" / file.relative_to(ROOT / "config")
        ).read_bytes() == file.read_bytes()


@pytest.mark.parametrize("pattern", ["service/demo/*", "service/console/page/*", "service/**/*.py", "drivers/**/*.py"])
def test_all_that_the_packages_hold_travels(unpacked, pattern):
    files = [p.relative_to(ROOT) for p in ROOT.glob(pattern) if p.is_file()]
    assert files
    assert [str(f) for f in files if not (unpacked / f).is_file()] == []


def test_it_carries_two_packages_and_its_licence_and_nothing_else(unpacked):
    info = f"bowlsight-{__version__}.dist-info"
    assert {p.name for p in unpacked.iterdir()} == {"service", "drivers", info}
    assert (unpacked / info / "licenses" / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_commands_find_what_they_need_in_it(bowlsight, tmp_path):
    assert bowlsight("--version").stdout == f"bowlsight {__version__}\n"
    assert bowlsight("devices").returncode == 0
    rendered = bowlsight("simulate", "bowl.mkv", "--generator", "system80", "--frames", 2)
    assert rendered.stderr == ""
    assert {p.name for p in tmp_path.iterdir()} == {"bowl.mkv", "bowl.json", "bowl.camera.toml"}
    named = bowlsight("simulate", "x.mkv", "--generator", "sistem80")
    assert named.returncode == 2
    assert "did you mean system80?" in named.stderr


def test_the_shipped_files_are_found_in_it(unpacked):
    code = (
        "from service.config.shipped import shipped_config; from service.demo import demo_video, demo_camera;"
        "print(shipped_config('station.toml'), demo_video(), demo_camera(), sep='\\n')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": str(unpacked)}, cwd="/", capture_output=True,
        text=True, check=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.stdout.splitlines() == [
        str(unpacked / part)
        for part in ("service/shipped/config/station.toml", "service/demo/bowl.mp4", "service/demo/camera.toml")
    ]
