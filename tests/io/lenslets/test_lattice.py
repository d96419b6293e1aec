"""Where lenslets stand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfref.io.lenslet_lattice import HEXAGONAL_ROWS, upright
from tests.io.lenslets.drawing import made


def test_a_level_square_lattice_stands_at_multiples_of_its_pitch():
    y, x = upright((14.0, 12.0), (6.5, 5.5)).centres(np.array([0, 3]), np.array([0, 2]))
    np.testing.assert_allclose((y, x), ((6.5, 48.5), (5.5, 29.5)))


def test_all_neighbours_in_a_hexagonal_lattice_are_equally_near():
    y, x = made(10.0, 7.0, is_hexagonal=True).centres(np.array([0, 0, 1, 1, -1, -1]), np.array([1, -1, 0, -1, 0, -1]))
    here = made(10.0, 7.0, is_hexagonal=True).centres(np.array(0), np.array(0))
    np.testing.assert_allclose(np.hypot(y - here[0], x - here[1]), 10)


def test_rows_that_fall_to_the_right_are_turned_by_more_than_nothing():
    lattice = made(10.0, 30.0)
    y, x = lattice.centres(np.array(0), np.array(2))
    assert (float(y) - 6.3, float(x) - 7.9) == pytest.approx((10, 20 * math.cos(math.radians(30))))
    assert lattice.rotation == pytest.approx(30)


def test_directions_are_a_pixel_long_and_follow_the_lattice():
    down, along = made(rotation=20.0).steps()
    assert math.hypot(*down) == pytest.approx(1)
    assert along == pytest.approx((math.sin(math.radians(20)), math.cos(math.radians(20))))
    assert down[0] * along[0] + down[1] * along[1] == pytest.approx(0)


def test_a_whole_number_of_aligned_lenslets_is_used_to_the_last():
    rows, columns = upright((14.0, 14.0), (6.5, 6.5)).within((14 * 5, 14 * 7), (6.5, 6.5))
    assert (rows, columns) == (range(5), range(7))


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
    assert len(rows) >= (size[0] - lost) / (pitch * (HEXAGONAL_ROWS if is_hexagonal else 1))
    assert len(columns) >= (size[1] - lost) / pitch


def test_a_picture_too_small_for_a_lenslet_has_none():
    rows, columns = made().within((10, 200), (6.0, 6.0))
    assert len(rows) * len(columns) == 0
