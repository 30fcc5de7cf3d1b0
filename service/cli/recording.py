"""Recording sessions as commands use it: the station file's [recording], what the options say, and the keys."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from service.cli.terminal import say
from service.sinks.session.control import RecordingError
from service.sinks.session.plan import RecordingPlan
from service.sinks.session.recorder import SessionRecorder

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from drivers.grabber import Clock
    from service.config.generators import SteamGenerator
    from service.config.recording import RecordingSettings
    from service.identity.counting import NamingRule
    from service.sinks.session.configuration import Configuration
    from service.sinks.session.control import SessionControl
    from service.sinks.viewer_drawing import Watch

__all__ = ["RecordingChoice", "keys_offered", "make_recorder", "on_key", "recorded_lines"]

RECORDING_KEYS, ALARM_KEYS = "v verify · m mark · r start or stop recording", "k acknowledge the alarms"


@dataclass(frozen=True, slots=True, eq=False)
class RecordingChoice:
    """What a command knows of what may be recorded."""

    settings: RecordingSettings
    configuration: Configuration
    rule: NamingRule


def make_recorder(
    args: argparse.Namespace,
    choice: RecordingChoice,
    kind: str,
    generator: SteamGenerator,
    clock: Clock,
    watch_for: Callable[[], Watch],
) -> SessionRecorder:
    """Make the recorder that the options and the station ask for; it records from the start, or once it is asked to."""
    s, folder = choice.settings, args.record
    settings = replace(
        s,
        enabled=s.enabled or folder is not None,
        folder=s.folder if folder is None or str(folder) == "-" else folder,
        csv=s.csv or args.csv,
        operator=args.operator or s.operator,
    )
    plan = RecordingPlan(
        settings, kind, generator.key, choice.configuration, choice.rule, tuple(args.anchor), args.target
    )
    if not settings.viewer:
        return SessionRecorder(plan, clock, remembers=True)
    # rerun takes most of a second to import: only where it serves
    from service.sinks.viewer_file import ViewerFileSink  # noqa: PLC0415

    return SessionRecorder(plan, clock, remembers=True, viewer_for=lambda path: ViewerFileSink(path, watch_for()))


def recorded_lines(recorder: SessionControl) -> list[str]:
    """What was recorded, for the summary."""
    state = recorder.state
    lines = []
    if state.last is not None:
        lost = f", {state.overflowed:,} LOST for want of room" if state.overflowed else ""
        evidence = f", {state.evidence:,} evidence records" if state.evidence else ""
        lines.append(
            f"  session      {state.frames:,} frames, {state.measured:,} measured{evidence}{lost}: {state.last}"
        )
    if state.failure is not None:
        lines.append(f"  session      {state.failure}")
    return lines


def keys_offered(recorder: SessionControl | None) -> str:
    """Say which keys there are."""
    return f"keys: {ALARM_KEYS}" if recorder is None else f"keys: {RECORDING_KEYS} · {ALARM_KEYS}"


def on_key(key: str, recorder: SessionControl | None, acknowledge: Callable[[], bool]) -> None:
    """Do what a key asks for, and say in a line what came of it."""
    if key == "k":
        say("alarms acknowledged" if acknowledge() else "there is no alarm that was not acknowledged")
    elif recorder is not None:
        _on_recording_key(key, recorder)


def _on_recording_key(key: str, recorder: SessionControl) -> None:
    try:
        if key == "v":
            record = recorder.verify(None)
            seen = record.values["tube_seen"] or "no named tube"
            say(f"verification {record.number}: {seen}, {record.values['verdict'] or record.values['lock']}")
        elif key == "m":
            say(f"mark set: evidence {recorder.mark('mark').number}")
        elif key == "r" and recorder.state.folder is None:
            say(f"recording into {recorder.start_recording()}")
        elif key == "r":
            say(f"recording stopped: {recorder.stop_recording()}")
    except RecordingError as error:
        say(str(error))
