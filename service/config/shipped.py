"""Where the files that come with Bowlsight are: beside the sources, or inside the wheel."""

from __future__ import annotations

from pathlib import Path

__all__ = ["shipped_config"]

_SERVICE = Path(__file__).resolve().parent.parent


def shipped_config(name: str) -> Path:
    """Path of a shipped configuration file, such as ``steam_generators.toml``."""
    installed = _SERVICE / "shipped" / "config" / name
    return installed if installed.exists() else _SERVICE.parent / "config" / name
