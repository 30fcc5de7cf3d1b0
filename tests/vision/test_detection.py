"""Blobs: dark discs of about a known size, with nothing else known."""

import numpy as np
import pytest

from service.vision.detection import find_blobs
from tests.vision.drawing import draw_ellipses

CENTERS = np.array([(x, y) for y in (30.3, 70.1, 110.6) for x in (28.4, 69.0, 111.7, 150.2)])


def discs(radius=10.0, size=(180, 140), flat=1.0, **grey):
    return draw_ellipses(size, [(x, y, radius, radius * flat, 0.0) for x, y in CENTERS], **grey)


def eight(picture):
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def furthest(blobs, centers=CENTERS):
    """Of the strongest blobs, as many as there are discs: the worst distance between the two."""
    off = np.linalg.norm(blobs.center_px[: len(centers), None] - centers[None], axis=2)
    return max(off.min(axis=0).max(), off.min(axis=1).max())


@pytest.mark.parametrize("told", [0.75, 1.0, 1.3])
@pytest.mark.parametrize("radius", [5.5, 8.0, 11.0])
def test_discs_are_the_strongest_blobs_though_their_size_is_told_roughly(radius, told):
    blobs = find_blobs(eight(discs(radius)), (told * radius, told * radius))
    assert len(blobs.center_px) >= len(CENTERS)
    assert furthest(blobs) < 0.12 * radius
    assert (np.diff(blobs.response) <= 0).all()


@pytest.mark.parametrize("light", [np.linspace(0.15, 1.0, 180)[None], np.linspace(1.0, 0.2, 140)[:, None]])
def test_uneven_light_hides_none(light):
    assert furthest(find_blobs(eight(discs() * light), (10.0, 10.0))) < 1.0


def test_sixteen_bits_give_what_eight_give():
    grey = eight(discs())
    small, large = find_blobs(grey, (10.0, 10.0)), find_blobs(grey.astype(np.uint16) * np.uint16(257), (10.0, 10.0))
    same = np.linalg.norm(large.center_px[:, None] - small.center_px, axis=2).argmin(axis=0)
    np.testing.assert_allclose(large.center_px[same], small.center_px, atol=0.05)
    np.testing.assert_allclose(large.response[same], small.response, rtol=0.02)


def test_a_field_has_its_own_radius_in_each_direction():
    blobs = find_blobs(eight(discs())[::2], (10.0, 5.0))
    assert furthest(blobs, CENTERS * [1.0, 0.5]) < 0.6


def test_specks_neither_hide_nor_make_discs():
    picture, rng = eight(discs()), np.random.default_rng(1)
    picture[rng.integers(0, 140, 300), rng.integers(0, 180, 300)] = 255
    blobs = find_blobs(picture, (10.0, 10.0))
    assert furthest(blobs) < 1.0
    assert (blobs.response[12:] < 0.5 * blobs.response[11]).all()


@pytest.mark.parametrize("grey", [0, 90, 255])
def test_a_blank_picture_shows_none(grey):
    blobs = find_blobs(np.full((120, 160), grey, np.uint8), (10.0, 10.0))
    assert blobs.center_px.shape == (0, 2)
    assert blobs.response.shape == (0,)


def test_bright_discs_are_none():
    blobs = find_blobs(eight(discs(dark=200, bright=60)), (10.0, 10.0))
    off = np.linalg.norm(blobs.center_px[:, None] - CENTERS[None], axis=2)
    assert off.size == 0 or off.min() > 5.0


def test_no_more_than_asked_for_and_those_the_strongest():
    every, few = find_blobs(eight(discs()), (10.0, 10.0)), find_blobs(eight(discs()), (10.0, 10.0), limit=5)
    assert len(few.center_px) == 5
    np.testing.assert_array_equal(few.center_px, every.center_px[:5])


@pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (7, 9), (16, 16)])
def test_pictures_too_small_to_show_a_disc_do_no_harm(shape):
    noise = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    blobs = find_blobs(noise, (10.0, 10.0))
    assert np.isfinite(blobs.center_px).all()
