"""HTML that cannot be broken by what is put into it: every text is escaped, unless it is HTML already."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["Content", "Html", "element", "facts", "free", "joined", "section", "table"]

VOID = ("br", "img", "meta")
LONG_WORD = 24


class Html(str):
    """Text that is HTML, and stands as it is."""

    __slots__ = ()


Content: TypeAlias = str | float | None
"""What stands in an element: HTML, a text, a number; None, nothing."""


def joined(parts: Iterable[Content]) -> Html:
    """Put parts one after the other."""
    return Html("".join(part if isinstance(part, Html) else escape(str(part)) for part in parts if part is not None))


def element(name: str, *content: Content, **attributes: str | None) -> Html:
    """Make an element; `class_` stands for class, and _ for - in names of attributes."""
    said = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Html(f"<{name}{said}>" if name in VOID else f"<{name}{said}>{joined(content)}</{name}>")


def table(head: Sequence[str], rows: Iterable[Sequence[Content]], class_: str | None = None) -> Html:
    """Make a table with a head that is repeated on every page."""
    lines = [element("tr", *(element("td", cell) for cell in row)) for row in rows]
    names = element("thead", element("tr", *(element("th", name, scope="col") for name in head)))
    return element("table", names, element("tbody", *lines), class_=class_)


def facts(pairs: Iterable[tuple[str, Content]]) -> Html:
    """Make a table of names and values; those without a value are left out."""
    rows = [
        element("tr", element("th", name, scope="row"), element("td", value))
        for name, value in pairs
        if value not in (None, "")
    ]
    return element("table", element("tbody", *rows), class_="facts")


def free(text: str) -> Html:
    """A text of somebody's own; only a word that is endless is broken."""
    return element("span", text, class_="free" if max(map(len, text.split()), default=0) > LONG_WORD else None)


def section(title: str, *content: Content, class_: str | None = None) -> Html:
    """Make a part of the report under its title."""
    return element("section", element("h2", title), *content, class_=class_)
