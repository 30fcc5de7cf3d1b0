import numpy as np
import pytest

from service.vision.camera import Camera, TsaiLens
from service.vision.lattice import Arrangement
from service.vision.linking import link
from tests.vision.drawing import PAPER_CAMERA, lattice_of, see, sites_of, turned

RADIUS_PX = 26.0


def shares_an_index(found, site):
    """Share of the used points that one shift of (row, column) explains."""
    shift = found.site[found.used] - site[found.used]
    return (shift == np.median(shift, axis=0)).all(axis=1).mean()


def seen(arrangement, rotation=None, count=3, keep=None, camera=PAPER_CAMERA):
    lattice = lattice_of(arrangement)
    site = sites_of(count)
    points = see(lattice, site, turned(6.85, -0.8, -0.34) if rotation is None else rotation, camera=camera)
    kept = np.ones(len(site), bool) if keep is None else keep(site)
    return lattice, site[kept], points[kept]


@pytest.mark.parametrize("arrangement", Arrangement)
@pytest.mark.parametrize("rz_deg", [0, 8, -13, 20])
def test_neighbours_get_neighbouring_indices_and_the_lattices_own_directions(arrangement, rz_deg):
    lattice, site, points = seen(arrangement, turned(20, -10, rz_deg))
    found = link(points, np.full(len(points), RADIUS_PX), lattice)
    assert found.reason is None
    assert found.used.all()
    assert shares_an_index(found, site) == 1


@pytest.mark.parametrize("arrangement", [Arrangement.TRIANGULAR, Arrangement.SQUARE])
def test_a_turned_sheet_is_indexed_with_x_rightwards(arrangement):
    lattice, _, points = seen(arrangement, turned(5, 0, 100))
    found = link(points, np.full(len(points), RADIUS_PX), lattice)
    sheet = lattice.sheet_points(*found.site.T)
    slope = np.linalg.lstsq(np.column_stack([sheet, np.ones(len(sheet))]), points)[0][:2].T
    assert np.linalg.det(slope) > 0
    assert abs(np.degrees(np.arctan2(slope[1, 0], slope[0, 0]))) <= lattice.turn_deg / 2 + 1


@pytest.mark.parametrize("arrangement", [Arrangement.TRIANGULAR, Arrangement.SQUARE])
def test_lanes_and_missing_tubes_are_bridged(arrangement):
    lattice, site, points = seen(arrangement, keep=lambda s: (s[:, 0] != 0) & (np.abs(s).sum(axis=1) != 3))
    found = link(points, np.full(len(points), RADIUS_PX), lattice)
    assert found.used.mean() > 0.9
    assert shares_an_index(found, site) == 1


def test_letters_and_stains_between_the_tubes_are_not_linked():
    lattice, site, points = seen(Arrangement.TRIANGULAR)
    rng = np.random.default_rng(5)
    size = np.array(PAPER_CAMERA.image_size_px)
    dirt = rng.uniform(0, 1, (40, 2)) * size
    away = np.min(np.linalg.norm(dirt[:, None] - points[None], axis=2), axis=1) > RADIUS_PX
    dirt = dirt[away]
    everything = np.concatenate([points, dirt])
    radii = np.concatenate([np.full(len(points), RADIUS_PX), rng.uniform(4, 17, len(dirt))])
    found = link(everything, radii, lattice)
    assert found.used[: len(points)].all()
    assert not found.used[len(points) :].any()
    assert (found.site[: len(points)] - site == found.site[0] - site[0]).all()


def test_noisy_centres_and_radii_are_linked_all_the_same():
    lattice, site, points = seen(Arrangement.TRIANGULAR)
    rng = np.random.default_rng(6)
    found = link(points + rng.normal(0, 2, points.shape), rng.normal(RADIUS_PX, 2, len(points)), lattice)
    assert found.used.mean() > 0.95
    assert shares_an_index(found, site) == 1


def test_pictures_of_other_pixels_than_square_ones_are_linked_by_their_aspect():
    camera = Camera(
        (640, 240), (0.0056, 0.0112), 18.8, TsaiLens(0.0), (318.0, 80.0)
    )  # one field of an interlaced frame
    lattice, site, points = seen(Arrangement.TRIANGULAR, camera=camera)
    found = link(points, np.full(len(points), RADIUS_PX / np.sqrt(2)), lattice, pixel_aspect=2.0)
    assert found.used.all()
    assert shares_an_index(found, site) == 1


def test_a_place_is_given_to_one_point_only():
    lattice, _, points = seen(Arrangement.SQUARE)
    doubled = np.concatenate([points, points[:5] + np.array([3.0, 2.0])])
    found = link(doubled, np.full(len(doubled), RADIUS_PX), lattice)
    used = found.site[found.used]
    assert len(np.unique(used, axis=0)) == len(used)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 2)),
        np.array([[100.0, 100.0]]),
        np.array([[100.0, 100.0], [180.0, 100.0], [140.0, 170.0]]),
        np.stack([np.arange(10) * 80.0, np.full(10, 50.0)], axis=1),
        np.zeros((12, 2)),
        np.random.default_rng(7).uniform(0, 600, (12, 2)),
    ],
    ids=["none", "one", "three", "one row", "one place", "scattered"],
)
@pytest.mark.parametrize("arrangement", [Arrangement.TRIANGULAR, Arrangement.SQUARE])
def test_what_is_no_lattice_is_refused_in_words(points, arrangement):
    found = link(points, np.full(len(points), RADIUS_PX), lattice_of(arrangement))
    assert found.reason
    assert not found.used.any()
    assert len(found.site) == len(points)
