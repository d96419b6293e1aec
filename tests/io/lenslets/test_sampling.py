"""Views come back from lenslet images that were drawn pixel by pixel."""

import numpy as np
import pytest

from lfref.io import lenslet_lattice, lenslets
from lfref.io.lenslet_lattice import upright
from tests.io.lenslets.drawing import lenslet_image, made, scene

ALL = slice(0, 13)


def expected(views, lattice, window, reach=6):
    """The scene at the places of the views' pixels, from the first lenslet that is used on."""
    rows, columns = lattice.within((220, 260), (reach, reach))
    first = lattice.pitch[1] / lattice.pitch[0] * (columns[0] + 0.5 * lattice.is_hexagonal)
    y, x = rows[0] + np.arange(views.shape[3]), first + np.arange(views.shape[4])
    v, u = (np.arange(cut.start, cut.stop) - reach for cut in window)
    return scene(y[:, None], x, v[:, None, None, None], u[:, None, None])


@pytest.mark.parametrize("rotation", [0.0, 0.3, -4.0])
def test_views_come_back_from_behind_square_lenslets(rotation):
    lattice, window = made(rotation=rotation), (slice(3, 10), slice(3, 10))
    image = lenslet_image(lattice, (220, 260))
    views = lenslet_lattice.read_views(image[..., None], lattice, (13, 13), window)
    assert views.shape[:3] == (7, 7, 1)
    np.testing.assert_allclose(views[:, :, 0], expected(views, lattice, window), atol=2e-4)


@pytest.mark.parametrize("rotation", [0.0, 0.3])
def test_views_from_behind_hexagonal_lenslets_have_square_pixels(rotation):
    lattice, window = made(rotation=rotation, is_hexagonal=True), (slice(4, 9), slice(4, 9))
    image = lenslet_image(lattice, (220, 260))
    views = lenslet_lattice.read_views(image[..., None], lattice, (13, 13), window)
    error = abs(views[:, :, 0] - expected(views, lattice, window))
    # Cubics between lenslets of a wave 11 lenslets long.
    assert error.max() < 6e-3


def test_rectangular_lenslets_give_square_pixels_too():
    lattice, window = upright((13.2, 15.5), (6.3, 7.9), 0.3), (slice(4, 9), slice(4, 9))
    image = lenslet_image(lattice, (220, 260))
    views = lenslet_lattice.read_views(image[..., None], lattice, (13, 13), window)
    assert abs(views[:, :, 0] - expected(views, lattice, window)).max() < 6e-3


def test_whole_pitches_that_are_aligned_are_the_pixels_themselves():
    image = np.random.default_rng(0).random((14 * 5 + 3, 14 * 6, 3), np.float32)
    window = (slice(4, 11), slice(2, 9))
    views = lenslet_lattice.read_views(image, upright((14.0, 14.0), (6.5, 6.5)), (14, 14), window)
    np.testing.assert_allclose(views, lenslets.unpack(image)[window], atol=1e-6)


def test_channels_do_not_mix():
    lattice = made()
    image = np.stack([lenslet_image(lattice, (120, 140)), np.full((120, 140), 0.25), np.ones((120, 140))], axis=-1)
    views = lenslet_lattice.read_views(image, lattice, (13, 13), (ALL, ALL))
    np.testing.assert_allclose(views[:, :, 1], 0.25, rtol=1e-6)
    np.testing.assert_allclose(views[:, :, 2], 1, rtol=1e-6)
    alone = lenslet_lattice.read_views(image[..., :1], lattice, (13, 13), (ALL, ALL))
    np.testing.assert_array_equal(views[:, :, :1], alone)


def test_between_pixels_quadratics_are_exact():
    y, x = np.mgrid[:12, :15].astype(float)
    picture = np.stack([0.1 * y**2 - 0.3 * y * x, 1 + 0.2 * x**2], axis=-1)
    padded = np.pad(picture, ((1, 3), (1, 3), (0, 0)), mode="edge").astype(np.float32)
    at_y, at_x = np.random.default_rng(0).uniform(1, 9, (2, 6, 7))
    samples = lenslet_lattice.between(padded, at_y, at_x)
    expected = np.stack([0.1 * at_y**2 - 0.3 * at_y * at_x, 1 + 0.2 * at_x**2], axis=-1)
    np.testing.assert_allclose(samples, expected, atol=2e-5)


@pytest.mark.parametrize(
    ("pitch", "count"), [(14, 14), (14.29, 13), (15.4, 15), (10.01, 9), (9.93, 9), (2, 2), (2.5, 1)]
)
def test_a_lenslet_has_its_pixels_as_views_or_an_odd_number(pitch, count):
    assert lenslet_lattice.n_views(pitch) == count


def test_no_lenslet_in_the_picture_gives_no_view():
    views = lenslet_lattice.read_views(np.zeros((10, 300, 1)), made(), (13, 13), (ALL, ALL))
    assert views.size == 0
    assert lenslet_lattice.read_views(np.zeros((10, 300, 1)), made(is_hexagonal=True), (13, 13), (ALL, ALL)).size == 0
