"""The command line."""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING

from drivers.errors import CalibrationError, ConfigError, DeviceError
from service.cli.parser import UsageError, parse
from service.cli.terminal import Interrupted, interruptible, logging_to_terminal, say, secure_streams

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

__all__ = ["main"]

PROBLEM, WRONG_USE, BROKEN_PIPE = 1, 2, 141


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit status.

    0: done. 1: it ran and found a problem. 2: wrong use, configuration or unreadable input. 130, 143: interrupted
    before it was done, by Ctrl-C or SIGTERM. 141: whoever read the output went away.
    """
    secure_streams()
    try:
        args = parse(sys.argv[1:] if argv is None else argv)
    except UsageError as error:
        say(str(error))
        return WRONG_USE
    except SystemExit as help_or_version:
        return int(help_or_version.code or 0)
    with logging_to_terminal(verbose=args.verbose):
        return _run(args)


def _run(args: argparse.Namespace) -> int:
    try:
        with interruptible():
            status: int = importlib.import_module(f"service.cli.{args.command.replace('-', '_')}").run(args)
            sys.stdout.flush()
            return status
    except Interrupted as interrupted:
        say("interrupted")
        return 128 + interrupted.signal
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left is flushed to nowhere
        return BROKEN_PIPE
    except Exception as error:  # noqa: BLE001 - whatever it is, an operator sees one line
        if args.verbose:
            sys.excepthook(type(error), error, error.__traceback__)
        status, message = _explain(error)
        say(message)
        return status


def _explain(error: Exception) -> tuple[int, str]:
    match error:
        case ConfigError() | DeviceError():
            return WRONG_USE, str(error)
        case CalibrationError():
            return PROBLEM, str(error)
        case RuntimeError() if "no locator available" in str(error):  # numba's words where it may write nowhere
            return WRONG_USE, (
                "compiled kernels: neither the installation nor the home folder may be written to by this user; set"
                " NUMBA_CACHE_DIR to a folder that may"
            )
        case OSError():
            return PROBLEM, f"{error.filename or 'output'}: {error.strerror or error}; what was written before is whole"
        case _:
            said = f"{type(error).__name__}: {error}"
            return PROBLEM, f"a mistake in Bowlsight: {said}; run it again with --verbose and report what that prints"
