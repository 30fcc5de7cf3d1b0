"""What checking the session found: whether the chain of evidence holds, and what else is not as it was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.report.markup import Html, element, section
from service.sinks.session.places import EVIDENCE
from service.sinks.session.verification import verify_session

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from service.report.digest import Digest
    from service.sinks.session.finding import Finding

__all__ = ["Checked", "check", "checked_section"]

MOST_SHOWN = 50


@dataclass(frozen=True, slots=True)
class Checked:
    """What was found, in a session with so many evidence records that are sound."""

    findings: Sequence[Finding]
    records: int

    @property
    def problems(self) -> int:
        """How many findings are grave."""
        return sum(finding.grave for finding in self.findings)

    @property
    def broken(self) -> bool:
        """Whether any of the evidence is not as it was written."""
        return any(finding.grave and finding.file.startswith(EVIDENCE) for finding in self.findings)

    @property
    def chain(self) -> str:
        """Whether the chain of evidence holds, in words."""
        if self.broken:
            return "✖ DOES NOT HOLD: see below"
        if not self.records:
            return "there is no evidence record"
        return f"✔ holds: {self.records:,} record{'s' * (self.records != 1)}, each as it was written"


def check(folder: Path, records: int, progress: Callable[[int, int], None]) -> Checked:
    """Check all of a session but its video; `progress` as in `verify_session`."""
    return Checked(list(verify_session(folder, videos=False, progress=progress)), records)


def checked_section(checked: Checked, digest: Digest) -> Html:
    """Say what was found."""
    said = [str(finding) for finding in checked.findings]
    said += [f"{problem}: {count:,} times" for problem, count in digest.problems.items()]
    shown = [element("li", text) for text in said[:MOST_SHOWN]]
    if len(said) > MOST_SHOWN:
        shown.append(element("li", f"and {len(said) - MOST_SHOWN:,} more; bowlsight verify names them"))
    how = (
        "Checked when this report was made: index, results, events, configuration and evidence with its pictures."
        " The video was not; bowlsight verify does that."
    )
    found = element("ul", *shown) if shown else element("p", "✔ All of it is as it was written.")
    return section("Checked", element("p", how), found, class_="alert" if checked.problems else None)
