"""How the live service does, told to all who ask: sinks, the log, Prometheus, the service manager."""

from __future__ import annotations

import contextlib
import logging
from typing import TYPE_CHECKING

from service.acquisition.liveness import MEASURING_S
from service.acquisition.metrics import HealthCollector, MetricsServer
from service.acquisition.notify import ServiceManager
from service.cli.status import health_figures
from service.sinks.base import SourceState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from drivers.grabber import Clock
    from service.acquisition.health import Health
    from service.config.supervision import HealthSettings

__all__ = ["Reporting"]

log = logging.getLogger(__name__)

SHOW_S = 1.0
"""How often figures are shown anew; what the picture is worth, at once."""


class Reporting:
    """Passes health snapshots on, each as often as whoever gets it needs it.

    Parameters
    ----------
    source
        Its name.
    show
        Gets what the picture is worth, and the figures.
    settings
        The station's.
    clock
        Paces it.
    manager
        Whoever started the process; None: as the environment says.
    """

    def __init__(
        self,
        source: str,
        show: Callable[[SourceState], None],
        settings: HealthSettings,
        clock: Clock,
        manager: ServiceManager | None = None,
    ) -> None:
        self._source, self._show, self._settings, self._clock = source, show, settings, clock
        self._manager = manager or ServiceManager(clock)
        self._shown_ns = self._logged_ns = self._clock.monotonic_ns()
        self._said: str | None = None

    @contextlib.contextmanager
    def running(self, health: Callable[[], Health]) -> Iterator[None]:
        """Let Prometheus ask, where that is wanted, and the service manager know, while the service runs."""
        with contextlib.ExitStack() as stack:
            if self._settings.metrics_port is not None:
                collector = HealthCollector(health, self._source)
                server = stack.enter_context(MetricsServer(self._settings.metrics_port, collector))
                print(f"metrics: {server.url}", flush=True)
            self._manager.ready(self._source)
            stack.callback(self._manager.stopping)
            yield

    def report(self, health: Health) -> None:
        """Pass a snapshot on. Called several times a second."""
        now_ns = self._clock.monotonic_ns()
        said = str(health.shown)
        if said != self._said:
            self._manager.status(f"{self._source}: {said}")
        if said != self._said or now_ns - self._shown_ns >= SHOW_S * 1e9:
            self._said, self._shown_ns = said, now_ns
            figures = "\n\n".join(f"**{what}** {figure}" for what, figure in health_figures(health).items())
            shown = health.shown
            self._show(SourceState(str(shown.liveness), shown.reason, shown.good, figures))
        if now_ns - self._logged_ns >= self._settings.log_every_s * 1e9:
            self._logged_ns = now_ns
            log.info("health: %s", "; ".join(f"{what} {figure}" for what, figure in health_figures(health).items()))
        if health.measuring_s is None or health.measuring_s < MEASURING_S:  # frames are seen to
            self._manager.alive()
