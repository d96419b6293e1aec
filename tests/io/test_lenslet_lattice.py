"""The lattice of lenslets, and views sampled from it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.io import lenslet_lattice, lenslets
from lfref.io.lenslet_lattice import upright
from lfref.io.samples import ROW_DISTANCES
from tests.io.lenslet_drawing import lenslet_image, made, scene


@settings(max_examples=40, deadline=None)
@given(st.floats(3, 20), st.floats(-10, 10), st.floats(-30, 30), st.floats(-30, 30), st.booleans(), st.floats(60, 200))
def test_a_block_lies_in_the_picture_and_leaves_little_of_it_out(pitch, rotation, top, left, is_hexagonal, side):
    lattice, size = made(pitch, rotation, is_hexagonal, (top, left)), (round(side), 150)
    rows, columns = lattice.within(size, (1.0, 1.0))
    if len(rows) and len(columns):
        y, x = lattice.centres(np.array(rows)[:, None], np.array(columns)[None, :])
        assert y.min() > 0.99
        assert x.min() > 0.99
        assert y.max() < size[0] - 1.99
        assert x.max() < size[1] - 1.99
    # What a turned rectangle loses on each side, and a lenslet more.
    lost = 2 * math.sin(math.radians(abs(rotation))) * 200 + 4 * pitch + 2
    assert len(rows) >= (size[0] - lost) / (pitch * (ROW_DISTANCES["hexagonal"] if is_hexagonal else 1))
    assert len(columns) >= (size[1] - lost) / pitch


ALL = slice(0, 13)


def expected(views, lattice, window, reach=6):
    """The scene at the places of the views' pixels, from the first lenslet that is used on."""
    rows, columns = lattice.within((220, 260), (reach, reach))
    first = lattice.pitch[1] / lattice.pitch[0] * (columns[0] + 0.5 * lattice.is_hexagonal)
    y, x = rows[0] + np.arange(views.shape[3]), first + np.arange(views.shape[4])
    v, u = (np.arange(cut.start, cut.stop) - reach for cut in window)
    return scene(y[:, None], x, v[:, None, None, None], u[:, None, None])


@pytest.mark.parametrize("rotation", [0.0, -4.0])
def test_views_come_back_from_behind_square_lenslets(rotation):
    lattice, window = made(rotation=rotation), (slice(3, 10), slice(3, 10))
    image = lenslet_image(lattice, (220, 260))
    views = lenslet_lattice.sample_views(image[..., None], lattice, (13, 13), window)
    assert views.shape[:3] == (7, 7, 1)
    np.testing.assert_allclose(views[:, :, 0], expected(views, lattice, window), atol=2e-4)


@pytest.mark.parametrize("rotation", [0.0, 0.3])
def test_views_from_behind_hexagonal_lenslets_have_square_pixels(rotation):
    lattice, window = made(rotation=rotation, is_hexagonal=True), (slice(4, 9), slice(4, 9))
    image = lenslet_image(lattice, (220, 260))
    views = lenslet_lattice.sample_views(image[..., None], lattice, (13, 13), window)
    error = abs(views[:, :, 0] - expected(views, lattice, window))
    # Cubics between lenslets of a wave 11 lenslets long.
    assert error.max() < 6e-3


def test_whole_pitches_that_are_aligned_are_the_pixels_themselves():
    image = np.random.default_rng(0).random((14 * 5 + 3, 14 * 6, 3), np.float32)
    window = (slice(4, 11), slice(2, 9))
    views = lenslet_lattice.sample_views(image, upright((14.0, 14.0), (6.5, 6.5)), (14, 14), window)
    np.testing.assert_allclose(views, lenslets.unpack(image)[window], atol=1e-6)


@pytest.mark.parametrize(("pitch", "count"), [(14, 14), (14.29, 13), (15.4, 15), (2, 2), (2.5, 1)])
def test_a_lenslet_has_its_pixels_as_views_or_an_odd_number(pitch, count):
    assert lenslet_lattice.n_views(pitch) == count


@pytest.mark.parametrize("is_hexagonal", [False, True])
def test_the_nearest_lenslet_is_the_nearest_of_all(is_hexagonal):
    lattice = made(rotation=2.0, is_hexagonal=is_hexagonal)
    rng = np.random.default_rng(0)
    y, x = rng.uniform(-50, 200, (2, 400))
    i, j = np.mgrid[-20:40, -20:40]
    centres = np.stack(lattice.centres(i, j), axis=-1).reshape(-1, 2)
    least = np.array([np.hypot(*(centres - place).T).min() for place in np.stack([y, x], axis=-1)])
    centre_y, centre_x = lattice.centres(*lattice.nearest(y, x))
    np.testing.assert_allclose(np.hypot(centre_y - y, centre_x - x), least, atol=1e-9)
