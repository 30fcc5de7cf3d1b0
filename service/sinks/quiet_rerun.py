"""Rerun, kept from writing into the terminal: its native half logs to standard error, over the status line."""

from __future__ import annotations

import os

os.environ.setdefault("RUST_LOG", "off")  # what goes wrong is noticed and told by the sinks themselves

import rerun as rr
import rerun.blueprint as rrb

__all__ = ["rr", "rrb"]
