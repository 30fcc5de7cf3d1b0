import math
from pathlib import Path

import pytest

from service import __version__
from service.cli import main
from service.cli.parser import COMMANDS, UsageError, parse


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_has_an_example_that_can_be_parsed(command, capsys):
    assert main([command, "--help"]) == 0
    out = capsys.readouterr().out
    _, _, example = out.partition("example:\n")
    words = example.split()
    assert words[:2] == ["bowlsight", command]
    assert parse(words[1:]).command == command


def test_help_lists_every_command_and_the_exit_statuses(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n    {command} " in out for command in COMMANDS)
    assert "2 wrong use" in out


def test_the_version_is_the_packages(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"bowlsight {__version__}\n"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", ["required: COMMAND", "bowlsight --help"]),
        ("analise", ["unknown command 'analise'", "did you mean analyze?"]),
        ("--verbos demo", ["unknown argument '--verbos'", "did you mean --verbose?"]),
        ("analyze", ["required", "PATH", "--generator", "bowlsight analyze --help"]),
        ("analyze a.png --generator x --jsnol -", ["unknown argument '--jsnol'", "did you mean --jsonl?"]),
        ("analyze a.png --generatr model-f", ["unknown argument '--generatr'", "did you mean --generator?"]),
        ("analyze a.png --generator x --csv -", ["--csv", "the name of a file"]),
        ("analyze a.png --gen model-f", ["--generator"]),
        ("analyze a.png --generator x --field-order odd", ["--field-order", "'odd'", "progressive"]),
        ("replay", ["required", "PATH"]),
        ("replay a.mp4 --speed fast", ["--speed", "'fast' is no number"]),
        ("replay a.mp4 --speed 0", ["--speed", "'0' must be max, or a factor from"]),
        ("replay a.mp4 --speed nan", ["--speed", "'nan' must be max"]),
        ("replay a.mp4 --save a.mp4", ["--save", "'a.mp4' must end in .rrd"]),
        ("demo --seconds -1", ["--seconds", "above 0"]),
        ("demo --seconds nan", ["--seconds", "above 0"]),
        ("demo --port 0", ["--port", "from 1 to 65535"]),
        ("demo --port 9e3", ["--port", "from 1 to 65535"]),
        ("simulate a.mkv --generator x --seed -3", ["--seed"]),
        ("simulate a.mkv --generator x --frames ²", ["--frames", "whole number"]),
        ("calibrate --points a.dat", ["give --camera FILE", "the pixel pitch"]),
        ("calibrate --points a --camera b --method tasi", ["'tasi'", "tsai"]),
    ],
)
def test_wrong_use_is_one_line_with_the_remedy(line, words, capsys):
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("bowlsight: ")
    assert err.count("\n") == 1
    for word in words:
        assert word in err


def test_verbose_may_stand_before_and_after_the_command():
    assert parse(["-v", "demo"]).verbose
    assert parse(["demo", "-v"]).verbose
    assert not parse(["demo"]).verbose


def test_values_arrive_as_what_they_are():
    args = parse(["replay", "a.mp4", "--speed", "max", "--save", "b.rrd", "--seconds", "2.5", "--port", "80"])
    assert (args.path, args.speed, args.save) == (Path("a.mp4"), math.inf, Path("b.rrd"))
    assert (args.seconds, args.port, args.loop) == (2.5, 80, False)


def test_an_option_is_never_guessed_from_its_beginning():
    with pytest.raises(UsageError):
        parse(["demo", "--sec", "3"])
