"""What is said of one picture: the JSON line's "alignment" object, as an object of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from service.alignment.verdict import Verdict
from service.vision.measurement import Lock, TubeState

if TYPE_CHECKING:
    import numpy as np

    from service.alignment.entry import Entry
    from service.alignment.geometry import Lean, TubeEnd
    from service.alignment.parallelism import Averaged
    from service.alignment.verdict import Judgement
    from service.identity.names import TubeName

__all__ = ["Alignment"]


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How the guide stands to the target, at one picture.

    Attributes
    ----------
    time_ns
        When that picture was exposed; of a repeated one, when it was first.
    target, lock
        What was asked for, in words, and how far the picture is to be trusted.
    name, place, state
        The tube that this is: its name and lattice place, as far as they are known, and what stands there.
    on_map, map_approximate
        Whether the map has such a tube, and whether that map is approximate; None without a map or a name.
    tube, lean, entry, parallelism
        The figures; None where there are none.
    judgement
        The verdict, and why.
    """

    time_ns: int
    target: str
    lock: Lock
    judgement: Judgement
    name: TubeName | None = None
    place: tuple[int, int] | None = None
    state: TubeState = TubeState.UNKNOWN
    on_map: bool | None = None
    map_approximate: bool | None = None
    tube: TubeEnd | None = None
    lean: Lean | None = None
    entry: Entry | None = None
    parallelism: Averaged | None = None

    @property
    def verdict(self) -> Verdict:
        """What the operator is told."""
        return self.judgement.verdict

    @property
    def quality(self) -> str:
        """Quality: good | uncertain | bad | stale, as display rules have it."""
        if self.verdict is Verdict.STALE:
            return "stale"
        if self.lock is Lock.NONE:
            return "bad"
        return "good" if self.lock is Lock.FULL and self.verdict is not Verdict.CANNOT_JUDGE else "uncertain"

    def to_dict(self) -> dict[str, Any]:
        """The JSON line's "alignment" object; see `docs/formats.md`."""
        j, lean, p = self.judgement, self.lean, self.parallelism
        return {
            "target": self.target if self.name is None else str(self.name),
            "offset_mm": None if lean is None else _rounded(lean.offset_mm),
            "sigma_mm": None if lean is None else _rounded(lean.offset_sigma_mm),
            "parallelism_deg": None if p is None else _rounded(p.deg),
            "parallelism_sigma_deg": None if p is None else _rounded(p.sigma_deg),
            "verdict": str(j.verdict),
            "quality": self.quality,
            "advice": j.advice,
            "advice_sheet": j.advice_sheet,
            "reasons": list(j.reasons),
            "help": [str(h) for h in j.helps],
            "grade": None if j.grade is None else j.grade.name.lower(),
            "place": None if self.place is None else list(self.place),
            "state": self.state.name.lower(),
            "on_map": self.on_map,
            "map_approximate": self.map_approximate,
            **_figures(lean),
            "parallelism_frames": None if p is None else p.frames,
            "entry": None if self.entry is None else _entry(self.entry),
        }


def _rounded(value: float | np.ndarray[Any, Any]) -> Any:
    return round(value, 5) if isinstance(value, float) else [round(v, 5) for v in value.ravel().tolist()]


def _figures(lean: Lean | None) -> dict[str, Any]:
    keys = ("offset_covariance_mm2", "tilt_deg", "tilt_sigma_deg", "slope", "gap_mm", "gap_sigma_mm")
    if lean is None:
        return dict.fromkeys(keys)
    xx, xy, _, yy = lean.covariance[:2, :2].ravel().tolist()
    values = (
        [round(v, 8) for v in (xx, xy, yy)],
        _rounded(lean.tilt_deg),
        _rounded(lean.tilt_sigma_deg),
        _rounded(lean.slope),
        _rounded(lean.gap_mm),
        _rounded(float(lean.covariance[4, 4]) ** 0.5),
    )
    return dict(zip(keys, values, strict=True))


def _entry(found: Entry) -> dict[str, Any]:
    return {
        "center_mm": _rounded(found.center_mm),
        "semi_axes_mm": [round(v, 5) for v in found.semi_axes_mm],
        "angle_deg": _rounded(found.angle_deg),
        "clearance_mm": _rounded(found.clearance_mm),
        "margin_mm": _rounded(found.margin_mm),
        "margin_sigma_mm": _rounded(found.margin_sigma_mm),
    }
