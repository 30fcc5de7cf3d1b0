"""The viewer as commands use it: none, live, recorded, or both."""

from __future__ import annotations

import os
import time
import webbrowser
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from service.cli.terminal import say

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from service.config.generators import SteamGenerator
    from service.config.station import ViewerSettings
    from service.sinks.base import SourceState
    from service.sinks.queued import QueuedSink
    from service.sinks.viewer import ViewerSink
    from service.sinks.viewer_drawing import Watch

__all__ = ["Viewing", "make_viewing", "viewer_watch"]


@dataclass(frozen=True, slots=True)
class Viewing:
    """What shows the results: `live`, if it is served, is one of `sinks`; `opens` says to start a browser."""

    sinks: Sequence[QueuedSink] = ()
    live: ViewerSink | None = None
    opens: bool = field(default=False)

    def announce(self) -> None:
        """Say where the viewer is, once it is started, and open it if asked."""
        if self.live is None:
            return
        print(f"viewer: {self.live.url}\n    or: {self.live.native_command}", flush=True)
        if self.opens and not _open(self.live.url):
            say("no browser can be opened from here; open the viewer's address yourself")

    def state(self, state: SourceState) -> None:
        """Show what the picture is worth."""
        for sink in self.sinks:
            sink.state(state)

    def event(self, text: str, level: str) -> None:
        """Show a line among the events: INFO, WARN or ERROR."""
        for sink in self.sinks:
            sink.event(text, level)


def _open(url: str) -> bool:
    """Open a browser window; never one that would take over this terminal."""
    graphical = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return graphical and webbrowser.open(url)


def viewer_watch(generator: SteamGenerator, kind: str, source: str) -> Callable[[], Watch]:
    """Give what makes the viewer's title, and its clock, once a viewer begins."""

    def watch() -> Watch:
        from service.sinks.viewer_drawing import Watch as Made  # noqa: PLC0415

        epoch_ns = time.time_ns() - time.monotonic_ns() if kind == "LIVE" else None
        title = source if kind == "LIVE" else f"{kind} {source}"  # whether it is live now, its state tells
        return Made(generator.lattice, f"{title} · {generator.label}", epoch_ns)

    return watch


def make_viewing(
    args: argparse.Namespace, settings: ViewerSettings, generator: SteamGenerator, kind: str, source: str
) -> Viewing:
    """Make the sinks that the options and the station ask for; nothing is started."""
    serves = settings.enabled and not args.no_viewer
    if not serves and args.save is None:
        return Viewing()
    # rerun takes most of a second to import: only where it serves
    from service.sinks.viewer import ViewerSink  # noqa: PLC0415
    from service.sinks.viewer_file import ViewerFileSink  # noqa: PLC0415

    watch = viewer_watch(generator, kind, source)()
    live = None
    if serves:
        live = ViewerSink(
            watch,
            address=settings.address,
            port=args.port or settings.port,
            web_port=args.web_port or settings.web_port,
            memory_limit=f"{settings.memory_mib}MiB",
        )
    recorded = [] if args.save is None else [ViewerFileSink(args.save, watch)]
    # a port that is taken is told before a recording that is there is begun anew
    return Viewing([*([live] if live else []), *recorded], live, args.open or settings.open_browser)
