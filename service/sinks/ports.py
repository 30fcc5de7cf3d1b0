"""Which port to listen on. Rerun only logs that a port is taken, and what it was to show is lost."""

from __future__ import annotations

import ipaddress
import socket
import time

from drivers.errors import ConfigError

__all__ = ["falls_silent", "free_port", "is_loopback", "listens"]

NEXT_PORTS = 50


def is_loopback(address: str) -> bool:
    """Whether `address` is an IPv4 address that only programs of this machine reach."""
    try:
        return ipaddress.IPv4Address(address).is_loopback
    except ipaddress.AddressValueError:
        return False


def free_port(address: str, wanted: int | None, default: int, key: str) -> int:
    """Find a port that nothing listens on.

    Parameters
    ----------
    wanted
        The one to take; None: `default`, or the next free one after it.
    key
        What people call the setting, for the error.

    Raises
    ------
    ConfigError
        The wanted port is taken or not this user's, or there is no such address here.
    """
    candidates = range(default, default + NEXT_PORTS) if wanted is None else [wanted]
    problem = ""
    for port in candidates:
        try:
            _try_to_bind(address, port)
        except OSError as error:
            problem = error.strerror or str(error)
        else:
            return port
    ports = f"{candidates[0]}" if wanted is not None else f"{candidates[0]} to {candidates[-1]}"
    raise ConfigError(
        f"{key} = {ports} at {address}: {problem}; name another {key}, or leave it out for the next free one"
    )


def _try_to_bind(address: str, port: int) -> None:
    with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as s:
        s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # ports of connections just closed are free
        s.bind((address, port))


def listens(address: str, port: int, timeout_s: float) -> bool:
    """Wait until something accepts connections; False where nothing does in time."""
    return _comes_to(address, port, timeout_s, accepted=True)


def falls_silent(address: str, port: int, timeout_s: float) -> bool:
    """Wait until nothing accepts connections any more; False where something still does then."""
    return _comes_to(address, port, timeout_s, accepted=False)


def _comes_to(address: str, port: int, timeout_s: float, *, accepted: bool) -> bool:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if _accepts(address, port) == accepted:
            return True
        time.sleep(0.01)
    return False


def _accepts(address: str, port: int) -> bool:
    try:
        socket.create_connection((address, port), timeout=1.0).close()
    except OSError:
        return False
    return True
