"""`bowlsight analyze`: every picture of every source, none dropped."""

from __future__ import annotations

import math
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Never

from tqdm import tqdm

from drivers.errors import ConfigError, DeviceError
from drivers.replay import ReplayGrabber
from service.acquisition.ledger import Ledger
from service.acquisition.measuring import FrameMeasurer
from service.cli.inputs import field_order, fitting_camera, station
from service.cli.interpreting import interpreter_for
from service.cli.live import prepare_kernels
from service.cli.outputs import check_outputs
from service.cli.terminal import Interrupted, say
from service.config.alignment import IdentitySettings
from service.config.cameras import read_camera
from service.config.generators import load_generator
from service.sinks.jsonl import JsonlWriter
from service.sinks.table import CsvWriter, TableWriter
from service.vision.process import Measurer

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from drivers.frame import Field, Frame
    from service.acquisition.ledger import Account
    from service.alignment.interpreter import Interpreter
    from service.config.generators import SteamGenerator
    from service.sinks.base import Sink
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Check everything first, then measure; returns the exit status."""
    generator = load_generator(args.generator)
    camera = read_camera(args.camera) if args.camera else None
    outputs = [Path(p) for p in (args.jsonl, args.csv) if p not in (None, "-")]
    check_outputs(outputs, [p for p in (*args.paths, args.camera, args.config) if p])
    interpreters = _interpreters(args, generator)
    grabbers = [ReplayGrabber(path, speed=math.inf) for path in args.paths]
    total = _check(grabbers, camera)
    field = field_order(args.field_order).field
    prepare_kernels()
    with ExitStack() as opened:
        writers = _writers(args)
        for writer in writers:
            writer.start()
            opened.callback(writer.close, 1.0)
        tqdm.monitor_interval = 0  # no thread of its own
        shows_rows = sys.stdout.isatty() and args.jsonl != "-"  # a bar would run into them
        bar = opened.enter_context(tqdm(total=total, unit="frame", disable=True if shows_rows else None, leave=False))
        return _Analysis(generator.lattice, camera, field, writers, bar).run(grabbers, interpreters)


def _interpreters(args: argparse.Namespace, generator: SteamGenerator) -> Sequence[Interpreter | None]:
    """One for each source: each has a lattice index of its own."""
    s = None if args.config is None else station(args.config)
    identity, guide = (IdentitySettings(), None) if s is None else (s.identity, s.alignment)
    found = [interpreter_for(args, identity, guide, generator) for _ in args.paths]
    of_place = any(i is not None and i.aligner is not None and i.aligner.target.place is not None for i in found)
    if len(args.paths) > 1 and (args.anchor or of_place):
        raise ConfigError(
            f"{args.paths[1]}: has a lattice index of its own, for which --anchor or a target by its place does not"
            " hold; analyze one PATH at a time"
        )
    return found


def _check(grabbers: Sequence[ReplayGrabber], camera: Camera | None) -> int | None:
    """Open each source once, before anything is written; how many frames there are, as far as they tell."""
    counts = []
    for i, grabber in enumerate(grabbers):
        with grabber:
            fitting_camera(camera, grabber.format, grabber.name, quiet=i > 0)
            counts.append(grabber.frame_count)
    known = [c for c in counts if c is not None]
    return sum(known) if len(known) == len(counts) else None


def _writers(args: argparse.Namespace) -> list[Sink]:
    writers: list[Sink] = []
    if args.jsonl is not None:
        writers.append(JsonlWriter(None if args.jsonl == "-" else Path(args.jsonl)))
    if args.csv is not None:
        writers.append(CsvWriter(args.csv))
    if args.jsonl != "-":
        writers.append(TableWriter())
    return writers


class _Analysis:
    def __init__(
        self, lattice: Lattice, camera: Camera | None, field: Field | None, writers: Sequence[Sink], bar: tqdm[Never]
    ) -> None:
        self._lattice, self._camera, self._field, self._writers, self._bar = lattice, camera, field, writers, bar
        self._ledger = Ledger()
        self._locked = self._pictures = 0

    def run(self, grabbers: Sequence[ReplayGrabber], interpreters: Sequence[Interpreter | None]) -> int:
        broken = False
        try:
            for grabber, interpreter in zip(grabbers, interpreters, strict=True):
                broken |= not self._source(grabber, interpreter)
        except Interrupted as interrupted:
            say(f"interrupted: {self._said(self._ledger.account())}; what is measured is written")
            return 128 + interrupted.signal
        account = self._ledger.account()
        say(self._said(account))
        return int(broken or account.failed > 0 or not account.balanced())

    def _source(self, grabber: ReplayGrabber, interpreter: Interpreter | None) -> bool:
        """Measure one source, from nothing; False where it breaks off."""
        self._ledger.begin_stream()
        with grabber:
            camera = fitting_camera(self._camera, grabber.format, grabber.name, quiet=True)
            vision = Measurer(camera, self._lattice, time.perf_counter_ns)
            measurer = FrameMeasurer(vision, self._field, grabber.clock, interpreter)
            grabber.start()
            try:
                for frame in grabber:
                    self._answer(frame, measurer)
            except DeviceError as error:
                say(str(error))
                return False
        return True

    def _answer(self, frame: Frame, measurer: FrameMeasurer) -> None:
        self._ledger.arrived(frame)
        results, outcome = measurer.answer(frame)
        self._ledger.settle(frame, outcome)
        for writer in self._writers:
            writer.accept(frame, results)
        self._pictures += len(results)
        self._locked += sum(r.measurement.pose is not None for r in results)
        self._bar.update()

    def _said(self, account: Account) -> str:
        odd = [
            f"{count:,} {what}"
            for count, what in (
                (account.lost, "missing from their recording"),
                (account.corrupt, "bad"),
                (account.failed, "that measuring failed on"),
                (account.in_flight, "unmeasured"),
            )
            if count
        ]
        frames = f"{account.delivered:,} frame{'s' * (account.delivered != 1)}"
        return f"{frames}{', ' if odd else ''}{', '.join(odd)}; {self._locked:,} of {self._pictures:,} pictures locked"
