import json
import os
import signal
import threading

import pytest

from service.cli import main
from service.vision.measurement import Lock
from tests.fakes.results import make_measurement

CAMERA = "image_size_px = [{}, {}]\npixel_pitch_mm = [0.005, 0.005]\n"


@pytest.fixture
def analyze(vision, capsys):
    """Run `analyze`; gives its status, its JSON lines, and its words on standard error."""

    def run(*arguments, out=None):
        status = main(["analyze", *map(str, arguments), "--generator", "model-f", "--jsonl", str(out or "-")])
        output, words = capsys.readouterr()
        text = out.read_text() if out else output
        return status, [json.loads(line) for line in text.splitlines() if line.startswith("{")], words

    return run


def test_every_frame_of_a_video_is_answered_in_order_by_one_measurer(analyze, vision, video):
    status, lines, words = analyze(video(frames=12))
    assert status == 0
    assert [line["sequence"] for line in lines] == list(range(12))
    assert len(vision.made) == 1
    assert vision.made[0].resets == 1
    assert "12 frames; 12 of 12 pictures locked" in words


def test_each_picture_named_is_a_source_of_its_own_and_a_folder_is_a_recording(analyze, vision, picture):
    paths = [picture(f"p/{i}.png", seed=i) for i in (1, 2, 10)]
    _, lines, _ = analyze(*paths)
    assert [line["source"] for line in lines] == [str(p) for p in paths]
    assert len(vision.made) == 3
    vision.made.clear()
    _, lines, _ = analyze(paths[0].parent)
    assert [line["sequence"] for line in lines] == [0, 1, 2]
    assert len(vision.made) == 1


def test_two_fields_are_two_lines_of_one_frame(analyze, vision, picture):
    vision.answer = lambda: [make_measurement(field="top"), make_measurement(field="bottom")]
    _, lines, words = analyze(picture(), "--field-order", "top")
    assert [(line["sequence"], line["field"]) for line in lines] == [(0, "top"), (0, "bottom")]
    assert vision.made[0].calls[0][2] == "interlaced-top-first"
    assert "1 frame; 2 of 2 pictures locked" in words


def test_a_frame_without_lock_is_a_result(analyze, vision, picture):
    vision.answer = lambda: [make_measurement(Lock.NONE, reason="too dark")]
    status, (line,), words = analyze(picture())
    assert (status, line["lock"], line["reason"], line["pose"]) == (0, "none", "too dark", None)
    assert "0 of 1 pictures locked" in words


def test_a_bad_picture_of_a_folder_is_a_line_with_its_defect(analyze, picture):
    folder = picture("p/1.png").parent
    (folder / "2.png").write_bytes((folder / "1.png").read_bytes()[:200])
    picture("p/3.png", size=(32, 24))
    picture("p/4.png", seed=4)
    status, lines, words = analyze(folder)
    assert status == 0
    assert [line["lock"] for line in lines] == ["full", "none", "none", "full"]
    assert all(line["reason"].startswith("bad frame: ") for line in lines[1:3])
    assert "32x24" in lines[2]["reason"]
    assert "4 frames, 2 bad" in words


def test_a_truncated_video_is_never_silently_shorter(analyze, video):
    path = video(frames=20)
    path.write_bytes(path.read_bytes()[:-9000])
    status, lines, words = analyze(path)
    missing = 20 - sum(line["lock"] == "full" for line in lines)
    assert missing > 0
    assert status == 1 or "bad" in words or "missing" in words


def test_a_frame_that_measuring_fails_on_is_a_line_and_a_problem(analyze, vision, video):
    answers = iter([None, ZeroDivisionError("oops"), None])

    def answer():
        if error := next(answers):
            raise error
        return [make_measurement()]

    vision.answer = answer
    status, lines, words = analyze(video(frames=3))
    assert status == 1
    assert [line["lock"] for line in lines] == ["full", "none", "full"]
    assert "1 that measuring failed on" in words


def test_without_a_camera_file_the_assumption_is_said_once(analyze, vision, picture):
    _, _, words = analyze(picture("a.png"), picture("b.png"))
    assert words.count("no camera file: pixels of ") == 1
    assert vision.made[0].camera.focal_length_mm is None


def test_the_table_is_for_people_and_leaves_standard_output_to_json_when_asked(vision, picture, capsys):
    assert main(["analyze", str(picture()), "--generator", "model-f"]) == 0
    header, row = capsys.readouterr().out.splitlines()
    assert header.startswith("source")
    assert "1000.00 ± 0.20" in row


def test_a_file_and_a_spreadsheet_can_be_had_at_once(analyze, picture, tmp_path):
    status, lines, _ = analyze(picture(), "--csv", tmp_path / "o.csv", out=tmp_path / "o.jsonl")
    assert status == 0
    assert len(lines) == 1
    assert len((tmp_path / "o.csv").read_text().splitlines()) == 2


class TestRefused:
    """With status 2 and one line, before anything is written."""

    @pytest.fixture
    def refuse(self, vision, capsys, tmp_path):
        out = tmp_path / "kept.jsonl"
        out.write_text("precious\n")

        def run(*arguments):
            assert main(["analyze", *map(str, arguments), "--jsonl", str(out)]) == 2
            output, words = capsys.readouterr()
            assert output == ""
            assert out.read_text() == "precious\n"
            (line,) = (w for w in words.splitlines() if "no camera file" not in w)
            return line

        return run

    def test_a_missing_source(self, refuse, picture, tmp_path):
        said = refuse(picture(), tmp_path / "none.mp4", "--generator", "model-f")
        assert said == f"bowlsight: {tmp_path}/none.mp4: cannot be opened: No such file or directory; check the path"

    @pytest.mark.parametrize(
        ("name", "data", "words"),
        [
            ("x.mp4", b"", "is empty"),
            ("x.mp4", b"no video at all" * 100, "x.mp4: "),
            ("x.png", b"no picture", "x.png: "),
            ("x.txt", b"text", "x.txt: "),
        ],
    )
    def test_what_is_no_recording(self, refuse, tmp_path, name, data, words):
        (tmp_path / name).write_bytes(data)
        assert words in refuse(tmp_path / name, "--generator", "model-f")

    def test_an_empty_folder(self, refuse, tmp_path):
        (tmp_path / "empty").mkdir()
        assert "holds no picture" in refuse(tmp_path / "empty", "--generator", "model-f")

    def test_an_unknown_generator(self, refuse, picture):
        assert "did you mean model-f?" in refuse(picture(), "--generator", "modelf")

    def test_a_bad_camera_file(self, refuse, picture, tmp_path):
        (tmp_path / "c.toml").write_text("image_size_px = [64]\n")
        said = refuse(picture(), "--generator", "model-f", "--camera", tmp_path / "c.toml")
        assert "c.toml: image_size_px" in said

    def test_a_camera_of_another_size_names_both(self, refuse, picture, tmp_path):
        (tmp_path / "c.toml").write_text(CAMERA.format(640, 480))
        said = refuse(
            picture(), picture("b.png", size=(32, 24)), "--generator", "model-f", "--camera", tmp_path / "c.toml"
        )
        assert "64x48 px" in said
        assert "[640, 480]" in said

    def test_the_second_source_of_another_size(self, refuse, picture, tmp_path):
        (tmp_path / "c.toml").write_text(CAMERA.format(64, 48))
        said = refuse(
            picture(), picture("b.png", size=(32, 24)), "--generator", "model-f", "--camera", tmp_path / "c.toml"
        )
        assert "b.png: its pictures are 32x24 px" in said

    def test_an_output_over_its_source(self, refuse, picture):
        path = picture()
        before = path.read_bytes()
        assert "is a source" in refuse(path, "--generator", "model-f", "--csv", path)
        assert path.read_bytes() == before


def test_an_output_that_cannot_be_written_is_refused(vision, picture, tmp_path, capsys):
    assert main(["analyze", str(picture()), "--generator", "model-f", "--csv", str(tmp_path / "gone" / "o.csv")]) == 2
    assert "gone/o.csv: cannot be written: No such file or directory" in capsys.readouterr().err


def test_a_full_disk_is_a_problem_of_one_line(vision, picture, capsys):
    assert main(["analyze", str(picture()), "--generator", "model-f", "--jsonl", "/dev/full"]) == 1
    assert "bowlsight: /dev/full: No space left on device" in capsys.readouterr().err


def test_an_interruption_keeps_what_was_measured(analyze, vision, video, tmp_path):
    count = iter(range(100))

    def answer():
        if next(count) == 5:
            os.kill(os.getpid(), signal.SIGINT)
            threading.Event().wait(10)
        return [make_measurement()]

    vision.answer = answer
    status, lines, words = analyze(video(frames=20), out=tmp_path / "o.jsonl")
    assert status == 130
    assert [line["sequence"] for line in lines] == [0, 1, 2, 3, 4]
    assert "interrupted: 6 frames, 1 unmeasured; 5 of 5 pictures locked; what is measured is written" in words
    assert words.count("interrupted") == 1
