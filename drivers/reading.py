"""How far what an instrument says can be trusted."""

from __future__ import annotations

import enum

__all__ = ["Quality"]


class Quality(enum.StrEnum):
    """GOOD: a value. BAD: an error, a timeout, or a value that cannot be; there is none. STALE: a value, too old."""

    GOOD = "good"
    BAD = "bad"
    STALE = "stale"
