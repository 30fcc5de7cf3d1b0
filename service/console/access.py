"""Who may do what: addresses and origins that are let in, tokens, how often.

On loopback every browser of this machine may watch and operate, and what guards it is where a request comes from: a
page of some other site, in the same browser, is refused by its Origin, and one that points its own name here by its
Host. On any other address a token is asked for as well.
"""

from __future__ import annotations

import collections
import enum
import hashlib
import hmac
import ipaddress
import secrets
import urllib.parse
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.grabber import Clock
    from service.config.console import ConsoleSettings

__all__ = ["Access", "Bucket", "Buckets", "Right", "Tokens"]

LOCAL_NAMES = ("localhost",)
TOKEN_BYTES = 24
LONGEST_TOKEN = 200
MOST_CLIENTS = 256


class Right(enum.IntEnum):
    """What somebody may do: nothing, watch, or watch and operate."""

    NONE = 0
    VIEW = 1
    CONTROL = 2


@dataclass(frozen=True, slots=True)
class Tokens:
    """The two secrets of one start, as they are shown once."""

    view: str
    control: str

    @classmethod
    def fresh(cls) -> Tokens:
        """Two that nobody can guess."""
        return cls(secrets.token_urlsafe(TOKEN_BYTES), secrets.token_urlsafe(TOKEN_BYTES))


class Access:
    """Lets requests in or not.

    Parameters
    ----------
    settings
        [console].
    port
        The one that is listened on.
    tokens
        None: none is asked for; only for loopback.
    """

    def __init__(self, settings: ConsoleSettings, port: int, tokens: Tokens | None) -> None:
        if tokens is None and not settings.is_loopback:
            raise ValueError(f"{settings.address} is no loopback address: it needs tokens")
        self._settings, self._tokens = settings, tokens
        self.port = port
        self.cookie = f"bowlsight-{port}"
        """Its name; cookies of one host are shared by all its ports."""

    @property
    def asks(self) -> bool:
        """Whether a token is asked for."""
        return self._tokens is not None

    def right(self, token: str | None) -> Right:
        """What the bearer of a token may do."""
        if self._tokens is None:
            return Right.CONTROL
        if token is None or len(token) > LONGEST_TOKEN:
            return Right.NONE
        given = _digest(token)
        control = hmac.compare_digest(given, _digest(self._tokens.control))
        view = hmac.compare_digest(given, _digest(self._tokens.view))
        return Right.CONTROL if control else Right.VIEW if view else Right.NONE

    def is_ours(self, host: str | None) -> bool:
        """Whether a Host header names this page: a plain address, localhost, or a name of the station file."""
        name, port = _split(host or "")
        if name is None or port not in (None, self.port):
            return False
        if name in LOCAL_NAMES or name in self._settings.names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or not self._settings.is_loopback

    def is_from_ours(self, origin: str | None, host: str | None) -> bool:
        """Whether a request comes from this page itself, by its Origin and Host; without an Origin it does not."""
        if origin is None or not self.is_ours(host):
            return False
        try:
            parts = urllib.parse.urlsplit(origin)
        except ValueError:
            return False
        return parts.scheme == "http" and parts.netloc.lower() == (host or "").lower()


def _digest(text: str) -> bytes:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).digest()


def _split(host: str) -> tuple[str | None, int | None]:
    """Name and port of a Host header, in small letters; no name where it is none."""
    try:
        parts = urllib.parse.urlsplit(f"//{host}")
        name, port = parts.hostname, parts.port
    except ValueError:
        return None, None
    if parts.username is not None or parts.path or parts.query or parts.fragment:
        return None, None
    return name, port


class Bucket:
    """Lets so many things through a second, and some more at once. For one thread.

    Parameters
    ----------
    rate_hz, burst
        How many in the long run, and how many at once.
    """

    def __init__(self, rate_hz: float, burst: float, clock: Clock) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._left, self._last_ns = burst, clock.monotonic_ns()

    def take(self) -> bool:
        """Whether one more may pass."""
        now_ns = self._clock.monotonic_ns()
        self._left = min(self._burst, self._left + (now_ns - self._last_ns) * 1e-9 * self._rate_hz)
        self._last_ns = now_ns
        if self._left < 1:
            return False
        self._left -= 1
        return True


class Buckets:
    """A bucket for each of the last clients. For one thread."""

    def __init__(self, rate_hz: float, burst: float, clock: Clock) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._kept: collections.OrderedDict[str, Bucket] = collections.OrderedDict()

    def take(self, client: str) -> bool:
        """Whether one more of this client's may pass."""
        bucket = self._kept.pop(client, None) or Bucket(self._rate_hz, self._burst, self._clock)
        self._kept[client] = bucket
        if len(self._kept) > MOST_CLIENTS:
            self._kept.popitem(last=False)
        return bucket.take()
