"""Lattice, lens and range finder watched against each other, and the odd one out named where there is one.

Three statements of one distance D, from the camera's centre to the sheet along the optical axis:

- the lattice's: the picture gives ``q = D / f`` well; with the camera's f that is ``D_lattice = q f_camera``;
- the lens's: the same q with the focal length of its zoom position, ``D_lens = q f_lens``;
- the range finder's own.

They are compared in pairs, as logarithms, so that what two share falls out. With relative sigmas s of f_camera,
f_lens, D_lattice and D_range, and ``s_q**2 = s_lattice**2 - s_camera**2`` ::

    lattice - lens            ln f_camera - ln f_lens     sigma**2 = s_camera**2 + s_lens**2
    lattice - range finder    ln D_lattice - ln D_range   sigma**2 = s_lattice**2 + s_range**2
    lens - range finder       ln D_lens - ln D_range      sigma**2 = s_q**2 + s_lens**2 + s_range**2

A pair disagrees beyond LIMIT sigmas. Within that it agrees, unless LIMIT sigmas are more than VAGUE: then anything
would. The odd one out is named only where exactly one pair agrees and both others disagree. Where the sigmas hold and
nothing is wrong, any pair disagrees in 0.7 % of independent trials, and one is named, wrongly, in 0.1 %. An error of 5
sigmas of both pairs it is in is named in 97 %, and another one for it in 0.2 % (1, 2 and 0.5 % for f, lens and range).
But most errors here last, as a wrong zoom table or a beam on a hose do: more frames prove no more.

What this cannot see: an error of q (a wrong pitch, a wrong lattice) moves lattice and lens alike, and looks as if the
range finder stood alone. And estimates made with each other's help agree always: the lattice's must rest on the
picture and the camera file, not on the lens or the range finder.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.vision.measurement import Pose

__all__ = ["Agreement", "Consistency", "LatticeStatement", "Pair", "Source", "Verdict", "check_consistency"]

LIMIT = 3.0
VAGUE = 0.2
RATIO_FLOOR = 0.004
"""Least relative sigma of D/f: what Tz/f was stable to in the paper (56.6 to 57.0), whatever f did."""


class Source(enum.StrEnum):
    """Who says how far it is."""

    LATTICE = "lattice"
    LENS = "lens"
    RANGE_FINDER = "range finder"


class Agreement(enum.StrEnum):
    """What two of them make of each other."""

    AGREE = "agree"
    DISAGREE = "disagree"
    VAGUE = "vague"


class Verdict(enum.StrEnum):
    """What comes of comparing them.

    AGREEMENT of all that can be compared. ODD_ONE_OUT: one is wrong, and named. DISAGREEMENT: something is wrong, and
    it cannot be told what. CANNOT_TELL: there is nothing to compare, or only what is too vague.
    """

    AGREEMENT = "agreement"
    ODD_ONE_OUT = "odd one out"
    DISAGREEMENT = "disagreement"
    CANNOT_TELL = "cannot tell"


@dataclass(frozen=True, slots=True)
class LatticeStatement:
    """What the picture says, with the camera's focal length: along the optical axis, mm, one sigma each."""

    distance_mm: float
    distance_sigma_mm: float
    focal_length_mm: float
    focal_sigma_mm: float

    @classmethod
    def of(cls, pose: Pose) -> LatticeStatement | None:
        """Take a pose's; None where it has no focal length."""
        f_mm = pose.camera.focal_length_mm
        if f_mm is None:
            return None
        along_axis = 1 / math.cos(math.radians(pose.tilt_deg))
        return cls(pose.distance_mm * along_axis, pose.sigma.distance_mm * along_axis, f_mm, pose.sigma.focal_length_mm)


@dataclass(frozen=True, slots=True)
class Pair:
    """Two of them compared: by how much `first` says more than `second`, and one sigma of that, relative."""

    first: Source
    second: Source
    difference: float
    sigma: float

    @property
    def agreement(self) -> Agreement:
        """Whether they agree."""
        if abs(self.difference) > LIMIT * self.sigma:
            return Agreement.DISAGREE
        return Agreement.AGREE if LIMIT * self.sigma <= VAGUE else Agreement.VAGUE


@dataclass(frozen=True, slots=True)
class Consistency:
    """The verdict, the odd one out where there is one, the pairs it rests on, and a line for the operator."""

    verdict: Verdict
    odd: Source | None
    pairs: tuple[Pair, ...]
    text: str


def check_consistency(
    lattice: LatticeStatement | None,
    lens_focal_length_mm: tuple[float, float] | None,
    range_finder_distance_mm: tuple[float, float] | None,
) -> Consistency:
    """Compare what there is; None for what there is not. Instruments give (value, sigma), mm."""
    pairs = _pairs(_sound(lattice), _sound_value(lens_focal_length_mm), _sound_value(range_finder_distance_mm))
    by_kind = {kind: [pair for pair in pairs if pair.agreement is kind] for kind in Agreement}
    agreeing, disagreeing = by_kind[Agreement.AGREE], by_kind[Agreement.DISAGREE]
    if len(disagreeing) == 2 and len(agreeing) == 1:
        (odd,) = set(Source) - {agreeing[0].first, agreeing[0].second}
        return Consistency(Verdict.ODD_ONE_OUT, odd, pairs, _odd_text(odd, agreeing[0], disagreeing))
    if disagreeing:
        text = f"{_words(disagreeing)}; it cannot be told which one is wrong"
        return Consistency(Verdict.DISAGREEMENT, None, pairs, text)
    if agreeing:
        return Consistency(Verdict.AGREEMENT, None, pairs, _words(agreeing))
    text = "too uncertain to be compared" if pairs else "fewer than two of lattice, lens and range finder say something"
    return Consistency(Verdict.CANNOT_TELL, None, pairs, text)


def _pairs(
    lattice: LatticeStatement | None, lens: tuple[float, float] | None, range_finder: tuple[float, float] | None
) -> tuple[Pair, ...]:
    if lattice is None:  # the lens alone says nothing of the distance
        return ()
    s_lattice = lattice.distance_sigma_mm / lattice.distance_mm
    s_camera = lattice.focal_sigma_mm / lattice.focal_length_mm
    q_known = math.isfinite(s_lattice) and s_lattice > s_camera
    s_q = max(RATIO_FLOOR, math.sqrt(s_lattice**2 - s_camera**2) if q_known else 0.0)
    pairs = []
    if lens is not None:
        s_lens, excess = lens[1] / lens[0], math.log(lens[0] / lattice.focal_length_mm)
        pairs.append(Pair(Source.LATTICE, Source.LENS, -excess, math.hypot(s_camera, s_lens)))
    if range_finder is not None:
        s_range, ahead = range_finder[1] / range_finder[0], math.log(lattice.distance_mm / range_finder[0])
        pairs.append(Pair(Source.LATTICE, Source.RANGE_FINDER, ahead, math.hypot(s_lattice, s_range)))
        if lens is not None:
            sigma = math.hypot(s_q, s_lens, s_range)
            pairs.append(Pair(Source.LENS, Source.RANGE_FINDER, ahead + excess, sigma))
    return tuple(pairs)


def _sound(lattice: LatticeStatement | None) -> LatticeStatement | None:
    if lattice is None:
        return None
    values = ((lattice.distance_mm, lattice.distance_sigma_mm), (lattice.focal_length_mm, lattice.focal_sigma_mm))
    return lattice if all(_sound_value(value) for value in values) else None


def _sound_value(value: tuple[float, float] | None) -> tuple[float, float] | None:
    """Leave out what is no number, or nought; a sigma may be infinite."""
    return value if value is not None and 0 < value[0] < math.inf and value[1] >= 0 else None


def _odd_text(odd: Source, agreeing: Pair, disagreeing: list[Pair]) -> str:
    text = f"{odd} is the odd one out: {_words(disagreeing)}, while {_words([agreeing])}"
    return text + ("; or pitch or lattice are wrong" if odd is Source.RANGE_FINDER else "")


def _words(pairs: list[Pair]) -> str:
    return ", ".join(
        f"{p.first} and {p.second} {'agree' if p.agreement is Agreement.AGREE else 'differ'} "
        f"({_percent(p.difference)}, limit {_percent(LIMIT * p.sigma)})"
        for p in pairs
    )


def _percent(relative: float) -> str:
    return f"{100 * math.expm1(abs(relative)):.1f} %"
