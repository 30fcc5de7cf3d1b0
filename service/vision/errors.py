"""What measuring functions raise where points do not determine what was asked."""

from __future__ import annotations

__all__ = ["DegenerateError"]


class DegenerateError(ValueError):
    """Points or pictures leave the answer open; the one-line message says why and what helps."""
