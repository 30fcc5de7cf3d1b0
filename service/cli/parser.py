"""The command line's words: every command, option and example. Imports nothing heavy, so that `--help` is quick."""

from __future__ import annotations

import argparse
import difflib
import itertools
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from service import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["COMMANDS", "UsageError", "parse"]

_LEADS_WITH_A_NUMBER = re.compile(r"^-[0-9]+")
"""An argument that begins so is a value, such as the lattice place -3,12, and no option."""
GENERATORS = "delta60, model-f, 51b, system80, candu6, or a .toml file with one"


class UsageError(Exception):
    """The command line was used wrongly; the message says how, in one line."""


class _Parser(argparse.ArgumentParser):
    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self._negative_number_matcher = _LEADS_WITH_A_NUMBER

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{' '.join(message.split())}; see {self.prog} --help")


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the command line; `command` names what to run.

    Raises
    ------
    UsageError
        It cannot be understood.
    SystemExit
        Help or the version was asked for, and printed.
    """
    parser, commands = _build()
    given = next((a for a in arguments if not a.startswith("-")), None)
    if given is not None and given not in commands:
        raise UsageError(f"unknown command {given!r}; {_nearest(given, list(commands))}see bowlsight --help")
    if given is not None:  # before what is missing: that may be what was misspelt
        known = {*_options(parser), *_options(commands[given])}
        options = [a for a in itertools.takewhile(lambda a: a != "--", arguments) if a.startswith("--")]
        _refuse([a for a in options if a.partition("=")[0] not in known], commands[given])
    args, unknown = parser.parse_known_args(arguments, argparse.Namespace(verbose=False))
    _refuse(unknown, commands[args.command])
    return args


def _refuse(unknown: Sequence[str], command: _Parser) -> None:
    if unknown:
        hint = _nearest(unknown[0], _options(command))
        raise UsageError(f"unknown argument {unknown[0]!r}; {hint}see {command.prog} --help")


def _options(parser: _Parser) -> list[str]:
    return [o for action in parser._actions for o in action.option_strings]  # noqa: SLF001 - has no public name


def _nearest(given: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(given.partition("=")[0], known, 1, 0.6)
    return f"did you mean {near[0]}? " if near else ""


def _build() -> tuple[_Parser, dict[str, _Parser]]:
    verbose = _Parser(add_help=False)
    verbose.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        default=argparse.SUPPRESS,  # given before the command, it must not be undone by the command's default
        help="say more while it runs, with tracebacks of what went wrong",
    )
    parser = _Parser(
        prog="bowlsight",
        parents=[verbose],
        description="Measure where a steam generator's tubes are in a picture, and how the camera stands to them.",
        epilog="example:\n  bowlsight demo\n\nexit status:\n"
        "  0 done   1 it ran and found a problem   2 wrong use, configuration or unreadable input",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"bowlsight {__version__}")
    adder = parser.add_subparsers(title="commands", dest="command", metavar="COMMAND", required=True)
    commands: dict[str, _Parser] = {}
    for name, (summary, example, options) in COMMANDS.items():
        commands[name] = adder.add_parser(
            name,
            parents=[verbose],
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            epilog=f"example:\n  bowlsight {name} {example}".rstrip(),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        options(commands[name])
    return parser, commands


# -- kinds of values ---------------------------------------------------------------------------------------------------


def _above_zero(text: str) -> float:
    value = _number(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number above 0")
    return value


def _speed(text: str) -> float:
    if text == "max":
        return math.inf
    value = _number(text)
    if not 0.01 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r} must be max, or a factor from 0.01 to 1000")
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None


def _point(text: str) -> tuple[float, float]:
    x, _, y = text.partition(",")
    point = _number(x), _number(y)
    if not all(map(math.isfinite, point)):
        raise argparse.ArgumentTypeError(f"{text!r} must be X,Y in pixels")
    return point


def _with_sigma(text: str) -> tuple[float, float | None]:
    """VALUE±SIGMA, or +- or +/- for those whose keyboard has no ±."""
    value, mark, sigma = re.sub(r"\+/?-", "±", text).partition("±")
    return _above_zero(value), _above_zero(sigma) if mark else None


def _whole(minimum: int, maximum: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not text.isascii() or not text.isdigit() or not minimum <= int(text) <= maximum:
            raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from {minimum} to {maximum}")
        return int(text)

    return read


def _file(text: str) -> Path:
    if text in {"", "-"}:
        raise argparse.ArgumentTypeError(f"{text!r} must be the name of a file")
    return Path(text)


def _rrd(text: str) -> Path:
    path = Path(text)
    if path.suffix != ".rrd":
        raise argparse.ArgumentTypeError(f"{text!r} must end in .rrd")
    return path


# -- options that several commands share -------------------------------------------------------------------------------


def _generator(p: _Parser, *, required: bool, default: str = "default: the station file's") -> None:
    said = "" if required else f"; {default}"
    p.add_argument("--generator", metavar="NAME", required=required, help=f"steam generator: {GENERATORS}{said}")


def _camera(p: _Parser) -> None:
    p.add_argument(
        "--camera", metavar="FILE", type=Path, help="camera file; without one, all but the pixels is estimated"
    )


def _field_order(p: _Parser) -> None:
    p.add_argument(
        "--field-order",
        choices=("auto", "progressive", "top", "bottom"),
        help="interlaced video: decide from the pictures (auto), never split, or which field comes first",
    )


def _viewer(p: _Parser) -> None:
    p.add_argument("--no-console", action="store_true", help="serve no operator's page")
    p.add_argument("--console-port", metavar="N", type=_whole(1, 65535), help="the operator's page's; default: 8420")
    p.add_argument("--no-viewer", action="store_true", help="serve no viewer")
    p.add_argument("--open", action="store_true", help="open the viewer in a browser")
    p.add_argument("--port", metavar="N", type=_whole(1, 65535), help="the viewer's data port; default: a free one")
    p.add_argument("--web-port", metavar="N", type=_whole(1, 65535), help="its page's port; default: a free one")
    p.add_argument("--save", metavar="FILE.rrd", type=_rrd, help="record what the viewer shows")
    p.add_argument("--seconds", metavar="N", type=_above_zero, help="stop after N seconds")


def _station(p: _Parser) -> None:
    p.add_argument(
        "--config", metavar="FILE", type=Path, help="station file; default: config/station.toml, or the one shipped"
    )


def _anchors(p: _Parser) -> None:
    p.add_argument(
        "--anchor",
        metavar="ROW,COLUMN=NAME",
        action="append",
        default=[],
        help="the tube at this lattice place has that name, such as 3,-2=L83R87; names all others; may be repeated",
    )


def _interpreting(p: _Parser) -> None:
    _anchors(p)
    p.add_argument(
        "--target",
        metavar="TUBE",
        help="the tube to align to: its name, its lattice place ROW,COLUMN, or nearest; default: the station file's",
    )


def _calibrating(p: _Parser) -> None:
    p.add_argument(
        "--calibrate",
        metavar="FILE",
        type=Path,
        help="calibrate the camera anew while it is tilted about, and keep this camera file up to date",
    )
    _known_beforehand(p, "when it is seen first; with --calibrate")


def _known_beforehand(p: _Parser, when: str) -> None:
    p.add_argument(
        "--range-mm",
        metavar="VALUE[±SIGMA]",
        type=_with_sigma,
        help=f"distance of the camera from the sheet, along its normal, {when}; ± 2 unless given",
    )
    p.add_argument(
        "--focal-length-mm",
        metavar="VALUE[±SIGMA]",
        type=_with_sigma,
        help="focal length, as a lens or its maker tells it, for a calibration; ± 3 %% unless given",
    )


# -- the commands ------------------------------------------------------------------------------------------------------


def _metrics(p: _Parser) -> None:
    p.add_argument(
        "--metrics",
        metavar="PORT",
        type=_whole(1, 65535),
        help="let Prometheus ask how the service does, at this port of this machine",
    )


def _recording(p: _Parser) -> None:
    p.add_argument(
        "--record",
        metavar="FOLDER",
        type=Path,
        nargs="?",
        const=Path("-"),
        help="record a session from the start, in FOLDER or the station file's",
    )
    p.add_argument("--csv", action="store_true", help="record results for spreadsheets, too")
    p.add_argument("--operator", metavar="NAME", default="", help="who is at the station, for the record")


def _demo(p: _Parser) -> None:
    _metrics(p)
    _calibrating(p)
    _viewer(p)


def _run(p: _Parser) -> None:
    _station(p)
    p.add_argument("--wait", action="store_true", help="wait for a device that is not there yet, instead of ending")
    _interpreting(p)
    _recording(p)
    _metrics(p)
    _calibrating(p)
    _viewer(p)


def _replay(p: _Parser) -> None:
    p.add_argument("path", metavar="PATH", type=Path, help="a video, a folder of pictures, or a recorded session")
    p.add_argument(
        "--speed", metavar="FACTOR|max", type=_speed, default=1.0, help="pace; at max every frame is measured"
    )
    p.add_argument("--loop", action="store_true", help="begin again at the end")
    p.add_argument(
        "--check",
        action="store_true",
        help="a session: measure it again, without a viewer; status 1 where a result is not that recorded",
    )
    _generator(p, required=False)
    _camera(p)
    _field_order(p)
    _station(p)
    _interpreting(p)
    _recording(p)
    _metrics(p)
    _calibrating(p)
    _viewer(p)


def _analyze(p: _Parser) -> None:
    p.add_argument(
        "paths", metavar="PATH", nargs="+", type=Path, help="a picture, a video, or a folder of pictures in their order"
    )
    _generator(p, required=True)
    _camera(p)
    _field_order(p)
    p.add_argument("--jsonl", metavar="FILE|-", help="a JSON line a picture; - for standard output, without the table")
    p.add_argument("--csv", metavar="FILE", type=_file, help="a row a picture, for spreadsheets")
    p.add_argument(
        "--config", metavar="FILE", type=Path, help="station file: its [identity] and [alignment] hold here too"
    )
    _interpreting(p)


def _compare(p: _Parser) -> None:
    p.add_argument("picture", metavar="PICTURE", type=Path, help="a picture of a tubesheet")
    _generator(p, required=True)
    _camera(p)
    p.add_argument("--json", metavar="FILE|-", help="the figures as JSON; - for standard output, without the table")


def _calibrate(p: _Parser) -> None:
    p.add_argument(
        "paths",
        metavar="PATH",
        nargs="*",
        type=Path,
        help="pictures, videos, folders of pictures or recorded sessions that show the tubesheet from several tilts",
    )
    _generator(p, required=False, default="needed with PATH")
    p.add_argument("--out", metavar="FILE", type=Path, help="camera file to write, with the covariance")
    p.add_argument(
        "--camera",
        metavar="FILE",
        type=Path,
        help="camera file: picture size and pixel pitch, and what is known; values with a sigma are bettered",
    )
    _known_beforehand(p, "in the first picture")
    _field_order(p)
    p.add_argument(
        "--points", metavar="FILE", type=Path, help='instead of PATH: lines of "xw yw zw Xf Yf", mm and px, for Tsai'
    )
    p.add_argument(
        "--method", choices=("tsai", "full"), help="with --points: Tsai's coplanar method (default), or all parameters"
    )
    p.add_argument("--json", metavar="FILE|-", help="the figures as JSON; - for standard output, without the report")


def _simulate(p: _Parser) -> None:
    p.add_argument("out", metavar="OUT", type=Path, help="video to write; its truth goes beside it, as .json")
    _generator(p, required=True)
    p.add_argument("--seed", type=_whole(0, 2**32 - 1), default=0, help="another number, another video; default: 0")
    p.add_argument("--frames", type=_whole(1, 100_000), default=125, help="its length; default: 125")


def _align_setup(p: _Parser) -> None:
    p.add_argument(
        "path", metavar="PATH", type=Path, help="a folder of pictures, or a video, with the guide over known tubes"
    )
    _generator(p, required=True)
    p.add_argument("--camera", metavar="FILE", type=Path, required=True, help="camera file")
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help="guide file to write")
    p.add_argument(
        "--guide-px", metavar="X,Y", type=_point, help="where in the picture it points: the nearest tube is meant"
    )
    p.add_argument(
        "--table",
        metavar="FILE",
        type=Path,
        help='instead: lines of "FRAMES TUBE [INSERTED_MM]", such as 10-25 3,-2 40',
    )
    p.add_argument(
        "--probe-diameter-mm", metavar="MM", type=_above_zero, help="outer diameter of what stands in the tubes"
    )
    p.add_argument("--play-sigma-mm", metavar="MM", type=_above_zero, help="instead: one sigma of its place, per axis")
    p.add_argument(
        "--inserted-mm",
        metavar="MM",
        type=_above_zero,
        default=0.0,
        help="how far it reaches, straight, into the tubes",
    )
    p.add_argument(
        "--gap-mm", metavar="MM", type=_above_zero, help="from the guide's mouth to the sheet, as measured then"
    )
    p.add_argument("--gap-sigma-mm", metavar="MM", type=_above_zero, default=0.5, help="one sigma of that; default 0.5")
    _anchors(p)
    _field_order(p)
    p.add_argument("--config", metavar="FILE", type=Path, help="station file: its [identity] names the tubes")


def _verify(p: _Parser) -> None:
    p.add_argument("session", metavar="SESSION", type=Path, help="a recorded session's folder")
    p.add_argument("--recompute", action="store_true", help="measure all of it again, too")


def _report(p: _Parser) -> None:
    p.add_argument("session", metavar="SESSION", type=Path, help="a recorded session's folder")
    p.add_argument("--out", metavar="FILE.html", type=_file, help="default: the session's name, in this folder")


def _sessions(p: _Parser) -> None:
    p.add_argument(
        "words", metavar="WORD", nargs="*", help="only those that have it: tube, name, operator, date, event"
    )
    p.add_argument(
        "--in", dest="folder", metavar="FOLDER", type=Path, help="folder of sessions; default: the station's"
    )
    p.add_argument("--since", metavar="DATE", help="begun on or after this day, such as 2026-11-22")
    p.add_argument("--until", metavar="DATE", help="begun on or before this day")
    p.add_argument("--tube", metavar="NAME", help="this tube was seen")
    p.add_argument("--rebuild", action="store_true", help="make the index of sessions anew from their folders")
    p.add_argument("--json", action="store_true", help="for programs: a JSON line a session")
    _station(p)


def _devices(p: _Parser) -> None:
    p.add_argument("--json", action="store_true", help="for programs")


COMMANDS: dict[str, tuple[str, str, Callable[[_Parser], None]]] = {
    "demo": ("play the bundled bowl video through the live service", "--open", _demo),
    "run": ("grab, measure and show, live, as the station file says", "--config config/station.toml", _run),
    "replay": ("play a recording through the live service", "bowl.mp4 --generator model-f --loop", _replay),
    "analyze": (
        "measure pictures and videos, every frame, without a viewer",
        "bowl.mp4 --generator model-f --camera camera.toml --jsonl out.jsonl",
        _analyze,
    ),
    "compare": (
        "compare the five ways to find a tube's centre, on one picture",
        "bowl.png --generator system80 --camera camera.toml",
        _compare,
    ),
    "calibrate": (
        "calibrate a camera from pictures of the tubesheet itself, or from points whose places are known",
        "installation.mkv --generator model-f --out camera.toml",
        _calibrate,
    ),
    "align-setup": (
        "measure where the guide is before the camera, from pictures with it over known tubes",
        "setup.mkv --generator model-f --camera camera.toml --guide-px 320,260 --play-sigma-mm 0.3 --out guide.toml",
        _align_setup,
    ),
    "simulate": ("render a bowl video with its truth", "bowl.mkv --generator model-f --seed 7", _simulate),
    "sessions": ("list and search recorded sessions", "L83R87 --since 2026-11-01", _sessions),
    "verify": ("check a session's evidence and every byte of it", "SESSION --recompute", _verify),
    "report": ("write a session's report, one HTML file for screen and paper", "SESSION --out report.html", _report),
    "devices": ("list the sources and devices of this machine", "", _devices),
}
"""Name: what it does, an example of its arguments, its options. Module `service.cli.NAME` runs it, with _ for -."""
