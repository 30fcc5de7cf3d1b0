"""One row a picture: for the eye, and for spreadsheets."""

from __future__ import annotations

import csv
import io
from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from service.sinks.base import SinkStats
from service.sinks.textfile import LineFile
from service.vision.measurement import Origin, angles_deg

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.vision.measurement import Measurement, Pose

__all__ = ["CSV_COLUMNS", "CsvWriter", "TableWriter", "tube_counts"]

POSE_COLUMNS = (
    "distance_mm", "distance_sigma_mm", "tilt_deg", "tilt_sigma_deg", "lateral_sigma_mm", "tz_mm", "tz_sigma_mm",
    "tx_mm", "ty_mm", "rx_deg", "ry_deg", "rz_deg", "focal_length_mm", "focal_length_sigma_mm", "reprojection_error_px",
)  # fmt: skip
CSV_COLUMNS = (
    "source", "sequence", "timestamp_ns", "field", "lock", "reason", "doubt", "measured", "inferred", *POSE_COLUMNS,
    "elapsed_ms",
)  # fmt: skip
SOURCE_WIDTH = 28
HEADER = (
    f"{'source':{SOURCE_WIDTH}} {'frame':>6} {'field':11} {'lock':8} {'tubes':>11}"
    f" {'distance mm':>20} {'tilt deg':>16} {'px':>6} {'ms':>7}"
)


def tube_counts(measurement: Measurement) -> tuple[int, int]:
    """Tubes measured, and tubes inferred."""
    measured = int(np.count_nonzero(measurement.tubes.origin == Origin.MEASURED))
    return measured, len(measurement.tubes) - measured


class _RowWriter(ABC):
    """Writes a header, then rows as they come."""

    name = "rows"

    def __init__(self, path: Path | None, header: str) -> None:
        self._file, self._header = LineFile(path), header
        self._written = 0

    def start(self) -> None:
        """Open the file and write the header; raises ConfigError where it cannot be written."""
        self._file.open()
        self._file.write(self._header)

    def accept(self, frame: Frame, results: Sequence[FrameResult]) -> None:  # noqa: ARG002 - pixels are not written
        """Write the rows of one frame; raises OSError where there is no room for them."""
        self.write(results)

    def write(self, results: Sequence[FrameResult]) -> None:
        """Write the rows of one frame's results."""
        for result in results:
            self._file.write(self._row(result))
        self._written += 1

    @abstractmethod
    def _row(self, result: FrameResult) -> str:
        """One result as the file has it."""

    def close(self, timeout_s: float) -> None:  # noqa: ARG002 - nothing waits to be written
        """Close the file."""
        self._file.close()

    def stats(self) -> SinkStats:
        """Frames written."""
        return SinkStats(accepted=self._written)


class TableWriter(_RowWriter):
    """A table for the eye, on standard output."""

    name = "table"

    def __init__(self) -> None:
        super().__init__(None, HEADER)

    def _row(self, result: FrameResult) -> str:
        m = result.measurement
        start = f"{_short(result.source):{SOURCE_WIDTH}} {result.sequence:6d} {m.field:11} {m.lock:8}"
        if m.pose is None:
            return f"{start} {m.reason}"
        p, s, (measured, inferred) = m.pose, m.pose.sigma, tube_counts(m)
        doubt = f"  doubt: {', '.join(m.doubt)}" if m.doubt else ""
        return (
            f"{start} {f'{measured}+{inferred}':>11} {f'{p.distance_mm:.2f} ± {s.distance_mm:.2f}':>20}"
            f" {f'{p.tilt_deg:.3f} ± {s.tilt_deg:.3f}':>16} {p.reprojection_error_px:6.3f}"
            f" {m.elapsed_ms.get('total', 0.0):7.1f}{doubt}"
        )


def _short(source: str) -> str:
    name = Path(source).name or source
    return name if len(name) <= SOURCE_WIDTH else f"{name[: SOURCE_WIDTH - 12]}..{name[-10:]}"


class CsvWriter(_RowWriter):
    """Comma-separated values with a header line; cells that have no value are empty."""

    name = "csv"

    def __init__(self, path: Path | None) -> None:
        super().__init__(path, _csv_line(CSV_COLUMNS))

    def _row(self, result: FrameResult) -> str:
        m = result.measurement
        head = (
            result.source, result.sequence, result.timestamp_ns, m.field, m.lock, m.reason, " ".join(m.doubt),
            *tube_counts(m),
        )  # fmt: skip
        pose = [None] * len(POSE_COLUMNS) if m.pose is None else _pose_cells(m.pose)
        return _csv_line((*head, *pose, m.elapsed_ms.get("total")))


def _pose_cells(pose: Pose) -> Sequence[float | None]:
    s, (tx, ty, tz) = pose.sigma, pose.translation_mm.tolist()
    return (
        pose.distance_mm, s.distance_mm, pose.tilt_deg, s.tilt_deg, s.lateral_mm, tz, s.tz_mm, tx, ty,
        *angles_deg(pose.rotation), pose.camera.focal_length_mm, s.focal_length_mm, pose.reprojection_error_px,
    )  # fmt: skip


def _csv_line(cells: Iterable[Any]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    return line.getvalue()
