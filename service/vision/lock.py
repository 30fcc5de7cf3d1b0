"""Whether a pose is to be believed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.indexing import STEPS
from service.vision.rims import accepted, measure_rims
from service.vision.roundness import out_of_round
from service.vision.sites import lattice_places, numbered

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.detection import Blobs
    from service.vision.lattice import Lattice
    from service.vision.refinement import Refined

    Array: TypeAlias = NDArray[np.float64]
    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

__all__ = ["Proof", "prove"]

LEAST_SHARE = 0.14
"""Least share of the places in the picture that must show a tube; half-dark pictures show a quarter."""
LEAST_TUBES = 8
DECOYS = 48
"""Measured tubes, at the most, beside which decoys are looked for."""
MOST_DECOYS = 0.2
"""Most tubes that may be "seen" between the tubes, as a share of those seen in their places."""
ALIKE = 0.6
"""A decoy counts as a tube where its edge has this share of the height of the edge of the tube beside it."""
STRONG, ASIDE, MOST_STRANGERS = 0.8, 0.2, 0.25
"""Most blobs, of those about as dark as the tubes measured, that may stand so many pitches off every place: a pattern
that fits the lattice in a corner of the picture only leaves a third or more, glare and hoses at most a sixth."""
LEAST_COMPANY = 0.3
"""Least share of the measured tubes' neighbours that are measured too. Light and hoses hide whole regions, and leave
0.6; on a lattice too fine by the root of 2 or 3, or by 2, tubes have no neighbours."""
NEIGHBOURS = {6: STEPS[6], 4: STEPS[4][:4]}
"""(row, column) steps to the nearest places."""
MOST_OUT_OF_ROUND = 0.036
"""Most that outlines may stray from a circle, in radii: squares do by 0.045 and more, rims by 0.03 at the most."""
MOST_STRAY = 3.0
"""Most that centres may stray beyond what they and the tubes' scatter explain."""
MOST_INSIDE, MOST_OUTSIDE = 0.12, 0.2
"""Most that the edge may lie inside and outside of the nominal rim, in rim radii, inside by an edge's width more: else
the scale is wrong. Lit bores and blur narrow what is dark; nothing widens it by more than the tube's wall."""


@dataclass(frozen=True, slots=True)
class Proof:
    """What speaks for a pose.

    Attributes
    ----------
    share
        Tubes measured, of the places that lie in the picture.
    decoys
        Tubes that the same test finds between the places, beside one measured tube: on a wrong lattice, many.
    strangers
        Blobs on no lattice place, of those about as dark as the tubes measured: on a wrong lattice, many.
    company
        Neighbours of the measured tubes that are measured too: on a lattice too fine, hardly any.
    out_of_round
        How far their outlines stray from circles, in radii: where the pose or the pattern is another, far.
    reason
        None, or in words why it is not believed.
    """

    share: float
    decoys: float
    strangers: float
    company: float
    out_of_round: float
    reason: str | None


def prove(image: Image, refined: Refined, lattice: Lattice, blobs: Blobs) -> Proof:
    """Test a refined pose against the picture and its blobs, between the tubes as well as on them."""
    fit = refined.fit
    vector = fit.camera.vector()
    measured = refined.shown
    share = refined.share
    a1, a2 = lattice.basis_mm
    between = a1 / 2, (a1 + a2) / (2 if lattice.arrangement.symmetry == 4 else 3)
    usual = float(np.median(refined.rims.radius_px[refined.used]))
    asked = np.flatnonzero(refined.used)[np.linspace(0, measured - 1, min(DECOYS, measured)).astype(np.int64)]
    gain, bore = refined.rims.gain[asked], refined.rims.bore[asked]
    found = 0
    for offset in between:
        places = refined.sites.sheet_mm[asked] + offset
        rims = measure_rims(image, vector, fit.rotation, fit.translation_mm, places, lattice, refined.common.profile)
        alike = (rims.gain > ALIKE * gain) & (rims.bore < bore + (1 - ALIKE) * gain)  # as dark as the tube beside it
        found = max(found, int((accepted(rims, refined.common.profile.width_px, usual) & alike).sum()))
    decoys, strangers, company = found / len(asked), _strangers(refined, lattice, blobs), _company(refined, lattice)
    fits = decoys <= MOST_DECOYS and strangers <= MOST_STRANGERS and company >= LEAST_COMPANY
    reason, stray = _reason(refined, lattice, measured, share, fits=fits), out_of_round(image, refined, lattice)
    if reason is None and stray > MOST_OUT_OF_ROUND:
        reason = "what stands in the tubes' places is not round"
    return Proof(share, decoys, strangers, company, stray, reason)


def _strangers(refined: Refined, lattice: Lattice, blobs: Blobs) -> float:
    """Share of the dark blobs that stand on no lattice place; 0 where no blob shows how dark tubes are."""
    fit = refined.fit
    index, off_mm = lattice_places(
        fit.camera.vector(), fit.rotation, fit.translation_mm, lattice.basis_mm, blobs.center_px
    )
    placed = off_mm < ASIDE * lattice.pitch_mm
    tubes = placed & _seen(refined, numbered(index[:, 0], index[:, 1]))
    if not tubes.any():
        return 0.0
    dark = blobs.response > STRONG * np.median(blobs.response[tubes])
    return float((~placed[dark]).mean())


def _company(refined: Refined, lattice: Lattice) -> float:
    """Share of the places next to measured tubes, as far as they are in the picture, that are measured too."""
    place = numbered(refined.sites.row, refined.sites.column)
    steps = numbered(*NEIGHBOURS[lattice.arrangement.symmetry].T)
    beside = np.concatenate(place[refined.used] + steps[:, None])
    there = _found(place, beside)
    return float(_seen(refined, beside[there]).mean()) if there.any() else 0.0


def _seen(refined: Refined, place: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether a tube was measured at each place, row and column in one number."""
    return _found(numbered(refined.sites.row, refined.sites.column)[refined.used], place)


def _found(places: NDArray[np.int64], asked: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether those asked for are among `places`, which rise, as sites do: many times as fast as np.isin."""
    return np.asarray(places[np.minimum(np.searchsorted(places, asked), len(places) - 1)] == asked)


def _reason(refined: Refined, lattice: Lattice, measured: int, share: float, *, fits: bool) -> str | None:
    radius_px = lattice.rim_radius_mm * float(np.median(np.linalg.norm(refined.place[:, 0, :2], axis=1)))
    if measured < LEAST_TUBES:
        return f"only {measured} tubes are seen"
    if share < LEAST_SHARE:
        return f"only {100 * share:.0f} % of the tubes are seen"
    if not fits:
        return "the pattern does not fit the tube lattice"
    if refined.fit.scatter_factor > MOST_STRAY:
        return "tube centres do not fit the lattice"
    edge = refined.common.profile
    if not -MOST_INSIDE * radius_px - edge.width_px <= edge.position_px <= MOST_OUTSIDE * radius_px:
        return "tube ends are not of the expected size"
    return None
