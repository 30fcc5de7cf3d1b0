"""The live service in words: the status line and the summary."""

from __future__ import annotations

from typing import TYPE_CHECKING

from service.acquisition.health import AcquisitionState
from service.acquisition.liveness import Liveness
from service.sinks.table import tube_counts
from service.vision.measurement import Lock

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from service.acquisition.health import Health, Percentiles
    from service.acquisition.worker import Answer
    from service.alignment.alarms import Alarm
    from service.vision.measurement import Measurement

__all__ = ["health_figures", "status_parts", "summary_lines"]


def status_parts(
    health: Health, latest: Answer | None, alarms: Sequence[Alarm] = (), *, brief: bool = False
) -> list[str]:
    """Parts of the status line, the most important first; `alarms` are those that nobody has acknowledged."""
    parts = [_state(health)]
    if alarms:
        count = f"{len(alarms)} ALARM{'S' * (len(alarms) > 1)}"
        parts.append(count if brief else f"{count}: {alarms[0].condition.reason}")
    if latest is not None:
        measurement = latest.results[-1].measurement
        parts += [
            f"last: {p}" if not health.shown.good and i == 0 else p for i, p in enumerate(_measured(measurement, brief))
        ]
        parts.append(f"{'' if brief else 'latency '}{latest.latency_ms:.0f} ms")
    account = health.account
    parts.append(f"{account.dropped:,} dropped")
    if bad := account.corrupt + account.failed:
        parts.append(f"{bad:,} bad")
    if account.unaccounted:
        parts.append(f"{account.unaccounted:,} UNACCOUNTED")
    return parts


def _state(health: Health) -> str:
    shown = health.shown
    if shown.good:
        bad = ", BAD FRAME" if health.state is AcquisitionState.DEGRADED else ""
        return f"{shown.liveness} {health.capture_fps:.1f} fps{bad}"
    silent = shown.liveness in (Liveness.STALE, Liveness.RECONNECTING) and health.silent_s is not None
    return f"{shown} (last frame {health.silent_s:.1f} s ago)" if silent else str(shown)


def _measured(m: Measurement, brief: bool) -> list[str]:
    if m.pose is None:
        return [f"lock none: {m.reason}"]
    doubt = f" ({', '.join(m.doubt)} in doubt)" if m.lock is Lock.PARTIAL else ""
    measured, inferred = tube_counts(m)
    s = m.pose.sigma
    distance = f"{m.pose.distance_mm:.2f} ±{s.distance_mm:.2f} mm"
    tilt = f"{m.pose.tilt_deg:.2f} ±{s.tilt_deg:.2f} deg"
    if brief:
        return [f"{m.lock}{doubt}", distance, tilt, f"{measured}+{inferred} tubes"]
    return [
        f"lock {m.lock}{doubt}",
        f"distance {distance}",
        f"tilt {tilt}",
        f"{measured} tubes measured + {inferred} inferred",
    ]


def summary_lines(health: Health, seconds: float, ended_by: str) -> list[str]:
    """What to print at the end: the ledger, the locks, the times, the sinks."""
    numbers, fates = health.account.lines()
    lines = [
        f"{ended_by} after {seconds:.1f} s",
        f"  frames       {numbers}",
        f"               {fates}",
        f"  lock         {_locks(health.locks)}",
        f"  timing       latency {_ms(health.latency_ms)}, age when measured {_ms(health.age_ms)}",
    ]
    if health.overflowed:
        lines.append(f"  recorder     {health.overflowed:,} frames found no room")
    for name, s in health.sinks.items():
        waiting = f", {s.depth:,} waiting" if s.depth else ""
        lines.append(f"  {name:12} {s.accepted:,} frames, {s.dropped:,} dropped, {s.failed:,} failed{waiting}")
    return lines


def health_figures(health: Health) -> dict[str, str]:
    """The health snapshot in words, by what each figure is of."""
    a, r = health.account, health.resources
    figures = {
        "source": f"{health.shown}, {health.state}, generation {health.generation}, {health.recoveries} recoveries",
        "frames": f"{health.capture_fps:.1f} /s in, {health.result_fps:.1f} /s answered, interval "
        f"{_ms(health.interval_ms)}",
        "age": f"{_ms(health.age_ms)} when measured, {_ms(health.latency_ms)} when answered",
        "counted": f"{a.delivered:,} delivered, {a.lost:,} lost, {a.processed:,} processed, "
        f"{a.superseded:,} superseded, {a.too_old:,} too old, {a.corrupt:,} corrupt, {a.failed:,} failed, "
        f"{a.unaccounted:,} unaccounted",
        "waiting": ", ".join(
            [f"{health.waiting} to be measured", *(f"{s.depth} for {name}" for name, s in health.sinks.items())]
        ),
    }
    if r.rss_bytes is not None:
        figures["process"] = f"{r.rss_bytes / 2**20:.0f} MiB, {r.fds} files open, {r.threads} threads"
    return figures


def _locks(locks: Mapping[str, int]) -> str:
    counts = ", ".join(f"{locks.get(lock, 0):,} {lock}" for lock in Lock)
    return f"{counts} of {sum(locks.values()):,} pictures"


def _ms(p: Percentiles) -> str:
    if p.p50 is None or p.p99 is None:
        return "unknown"
    return f"p50 {p.p50:.1f} ms, p99 {p.p99:.1f} ms"
