import os

import pytest

from drivers.errors import ConfigError
from service.cli.outputs import check_outputs


def test_what_can_be_written_is_left_as_it_is(tmp_path):
    there, new = tmp_path / "there.csv", tmp_path / "new.csv"
    there.write_text("precious")
    check_outputs([there, new], [tmp_path / "source.png"])
    assert there.read_text() == "precious"
    assert not new.exists()


@pytest.mark.parametrize("name", ["source.png", "./source.png", "link.png"])
def test_a_source_is_never_written_over(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    source = tmp_path / "source.png"
    source.write_text("precious")
    (tmp_path / "link.png").symlink_to(source)
    with pytest.raises(ConfigError, match="is a source, or another output"):
        check_outputs([tmp_path / name], [source])


def test_two_outputs_do_not_share_a_file(tmp_path):
    with pytest.raises(ConfigError, match="is a source, or another output"):
        check_outputs([tmp_path / "a", tmp_path / "a"], [])


@pytest.mark.parametrize(("name", "words"), [("", "Is a directory"), ("gone/a", "No such file")])
def test_what_cannot_be_written_is_told_with_its_name_before_another_is_begun(tmp_path, name, words):
    first, bad = tmp_path / "first", tmp_path / name
    first.write_text("precious")
    with pytest.raises(ConfigError, match=words) as error:
        check_outputs([first, bad], [])
    assert str(error.value).startswith(f"{bad}: cannot be written")
    assert first.read_text() == "precious"


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    check_outputs([tmp_path / "pipe"], [])
