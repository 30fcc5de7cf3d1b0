import csv
import errno
import json
import os

import pytest

from drivers.errors import ConfigError
from service.sinks.jsonl import JsonlWriter
from service.sinks.table import CSV_COLUMNS, CsvWriter, TableWriter
from service.sinks.textfile import LineFile
from service.vision.measurement import Lock
from tests.fakes.results import make_result
from tests.fakes.scripted import make_frame

RESULTS = [
    make_result(),
    make_result(Lock.PARTIAL, sequence=1, field="top"),
    make_result(Lock.NONE, sequence=2, reason='too dark, "black"'),
]


def write(writer):
    writer.start()
    for result in RESULTS:
        writer.accept(make_frame(), [result])
    writer.close(1.0)
    writer.close(1.0)
    assert writer.stats().accepted == len(RESULTS)


def test_a_json_line_a_picture(tmp_path):
    write(JsonlWriter(tmp_path / "out.jsonl"))
    lines = [json.loads(line) for line in (tmp_path / "out.jsonl").read_text().splitlines()]
    assert lines == [r.to_dict() for r in RESULTS]
    assert [line["lock"] for line in lines] == ["full", "partial", "none"]


def test_json_lines_on_standard_output(capsys):
    write(JsonlWriter(None))
    assert [json.loads(line)["sequence"] for line in capsys.readouterr().out.splitlines()] == [0, 1, 2]


def test_two_fields_are_two_lines_of_one_frame(tmp_path):
    writer = JsonlWriter(tmp_path / "out.jsonl")
    writer.start()
    writer.accept(make_frame(), [make_result(field="top"), make_result(field="bottom")])
    writer.close(1.0)
    assert [json.loads(s)["field"] for s in (tmp_path / "out.jsonl").read_text().splitlines()] == ["top", "bottom"]
    assert writer.stats().accepted == 1


def test_a_spreadsheet_has_a_named_cell_for_each_figure(tmp_path):
    write(CsvWriter(tmp_path / "out.csv"))
    with (tmp_path / "out.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == CSV_COLUMNS
    assert float(rows[0]["distance_mm"]) == pytest.approx(1000)
    assert float(rows[0]["distance_sigma_mm"]) == 0.2
    assert float(rows[0]["tilt_deg"]) == pytest.approx(5)
    assert float(rows[0]["rx_deg"]) == pytest.approx(5)
    assert (rows[0]["measured"], rows[0]["inferred"], rows[0]["elapsed_ms"]) == ("3", "2", "12.34")
    assert (rows[1]["doubt"], rows[1]["field"]) == ("index", "top")
    assert (rows[2]["reason"], rows[2]["distance_mm"]) == ('too dark, "black"', "")
    assert None not in rows[2].values()


def test_a_table_gives_every_figure_its_sigma_and_every_failure_its_reason(capsys):
    write(TableWriter())
    header, full, partial, none = capsys.readouterr().out.splitlines()
    assert " ".join(full.split()) == "bowl.mp4 0 progressive full 3+2 1000.00 ± 0.20 5.000 ± 0.050 0.080 12.3"
    assert full.index("12.3") + 4 == len(header)
    assert partial.endswith("doubt: index")
    assert none.split(maxsplit=4)[3:] == ["none", 'too dark, "black"']


def test_a_long_name_keeps_the_columns_in_place(capsys):
    writer = TableWriter()
    writer.start()
    writer.accept(make_frame(), [make_result(source="/very/long/" + "x" * 60 + "_0123.png"), make_result()])
    _, long, short = capsys.readouterr().out.splitlines()
    assert len(long) == len(short)
    assert "_0123.png" in long


@pytest.mark.parametrize("make", [JsonlWriter, CsvWriter])
def test_an_output_that_cannot_be_written_is_refused_before_anything_starts(tmp_path, make):
    with pytest.raises(ConfigError, match=r"gone.*cannot be written: No such file or directory; choose"):
        make(tmp_path / "gone" / "out").start()
    with pytest.raises(ConfigError, match="Is a directory"):
        make(tmp_path).start()


def test_a_full_disk_keeps_the_whole_lines(tmp_path, monkeypatch):
    path, real = tmp_path / "out.txt", os.write
    file = LineFile(path)
    file.open()
    file.write("first")
    room = [4]

    def nearly_full(handle, data):
        if not room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(handle, data[: room.pop()])

    monkeypatch.setattr(os, "write", nearly_full)
    with pytest.raises(OSError, match="No space left") as error:
        file.write("second")
    assert error.value.filename == str(path)
    monkeypatch.undo()
    file.write("third")
    file.close()
    assert path.read_text() == "first\nthird\n"


def test_a_file_name_that_is_no_text_is_written_as_it_is(tmp_path):
    file = LineFile(tmp_path / "o")
    file.open()
    file.write(os.fsdecode(b"b\xfcwl.mp4"))
    file.close()
    assert (tmp_path / "o").read_bytes() == b"b\xfcwl.mp4\n"


def test_a_device_without_room_says_so():
    file = LineFile("/dev/full")
    file.open()
    with pytest.raises(OSError, match="No space left"):
        file.write("x")
    file.close()
