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
from service.cli.inputs import field_order, fitting_camera
from service.cli.live import prepare_kernels
from service.cli.terminal import Interrupted, say
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
    from service.sinks.base import Sink
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Check everything first, then measure; returns the exit status."""
    lattice = load_generator(args.generator).lattice
    camera = read_camera(args.camera) if args.camera else None
    outputs = [Path(p) for p in (args.jsonl, args.csv) if p not in (None, "-")]
    _refuse_overwriting(outputs, [p for p in (*args.paths, args.camera) if p])
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
        return _Analysis(lattice, camera, field, writers, bar).run(grabbers)


def _check(grabbers: Sequence[ReplayGrabber], camera: Camera | None) -> int | None:
    """Open each source once, before anything is written; how many frames there are, as far as they tell."""
    counts = []
    for i, grabber in enumerate(grabbers):
        with grabber:
            fitting_camera(camera, grabber.format, grabber.name, quiet=i > 0)
            counts.append(grabber.frame_count)
    known = [c for c in counts if c is not None]
    return sum(known) if len(known) == len(counts) else None


def _refuse_overwriting(outputs: Sequence[Path], sources: Sequence[Path]) -> None:
    """Never write over what is to be read, nor two outputs into one file."""
    taken = {p.resolve() for p in sources}
    for path in outputs:
        if path.resolve() in taken:
            raise ConfigError(f"{path}: is a source, or another output, already; choose another name")
        taken.add(path.resolve())


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

    def run(self, grabbers: Sequence[ReplayGrabber]) -> int:
        broken = False
        try:
            for grabber in grabbers:
                broken |= not self._source(grabber)
        except Interrupted as interrupted:
            say(f"interrupted: {self._said(self._ledger.account())}; what is measured is written")
            return 128 + interrupted.signal
        account = self._ledger.account()
        say(self._said(account))
        return int(broken or account.failed > 0 or not account.balanced())

    def _source(self, grabber: ReplayGrabber) -> bool:
        """Measure one source, from nothing; False where it breaks off."""
        self._ledger.begin_stream()
        with grabber:
            camera = fitting_camera(self._camera, grabber.format, grabber.name, quiet=True)
            measurer = FrameMeasurer(Measurer(camera, self._lattice, time.perf_counter_ns), self._field, grabber.clock)
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
