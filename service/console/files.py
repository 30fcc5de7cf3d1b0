"""The files of the page, read once: a request can name one of these and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["INDEX", "PageFile", "page_files"]

INDEX: Final = "index.html"
KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


@dataclass(frozen=True, slots=True)
class PageFile:
    """One file, and how a browser is to take it."""

    kind: str
    content: bytes


def page_files() -> Mapping[str, PageFile]:
    """All files of the page, by name."""
    found = {}
    for entry in files("service.console").joinpath("page").iterdir():
        kind = KINDS.get(entry.name[entry.name.rfind(".") :])
        if kind is not None:
            found[entry.name] = PageFile(kind, entry.read_bytes())
    return found
