"""[console] of a station file: the operator's page."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.config.table import Table

__all__ = ["ConsoleSettings", "read_console"]

HOST_NAME = re.compile(r"(?=.{1,253}$)[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?(\.[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?)*")


@dataclass(frozen=True, slots=True)
class ConsoleSettings:
    """[console].

    Attributes
    ----------
    enabled
        Whether the page is served.
    address, port
        Where; a port that is None is 8420, or the next that is free.
    names
        Host names by which browsers may reach it, beside plain addresses.
    clients
        Pages that may be open at once.
    rate_hz
        Updates a page gets at most, a second.
    jpeg_quality
        Of the picture that is shown; what is measured is never compressed.
    """

    enabled: bool = True
    address: str = "127.0.0.1"
    port: int | None = None
    names: tuple[str, ...] = ()
    clients: int = 16
    rate_hz: float = 30.0
    jpeg_quality: int = 85

    @property
    def is_loopback(self) -> bool:
        """Whether only programs of this machine reach it."""
        return ipaddress.ip_address(self.address).is_loopback


def read_console(t: Table) -> ConsoleSettings:
    """Read [console]."""
    default = ConsoleSettings()
    settings = ConsoleSettings(
        enabled=t.flag("enabled", default.enabled),
        address=_address(t, default.address),
        port=t.integer("port", default.port, minimum=1, maximum=65535),
        names=_names(t),
        clients=t.integer("clients", default.clients, minimum=1, maximum=64),
        rate_hz=t.number("rate_hz", default.rate_hz, minimum=1, maximum=30),
        jpeg_quality=t.integer("jpeg_quality", default.jpeg_quality, minimum=50, maximum=100),
    )
    t.finish()
    return settings


def _address(t: Table, default: str) -> str:
    address: str = t.text("address", default)
    try:
        ipaddress.ip_address(address)
    except ValueError:
        raise t.error(
            "address", "must be an address of this machine: 127.0.0.1 for itself alone, 0.0.0.0 for all of its networks"
        ) from None
    return address


def _names(t: Table) -> tuple[str, ...]:
    names: tuple[str, ...] = t.texts("names", ())
    for name in names:
        if not HOST_NAME.fullmatch(name):
            raise t.error("names", f"{name!r} is no host name; give names like station7.plant, without http:// or port")
    return names
