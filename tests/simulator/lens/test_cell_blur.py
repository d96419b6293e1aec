"""Filters of a cell: as much blur as a box, and sums of look-ups as one filter."""

import numpy as np
import pytest
import torch

from lfref.simulator import scenery
from lfref.simulator.scenery import Aperture, cut


@pytest.mark.parametrize("width", [0.0, 0.4, 1.0, 2.5, 7.0, 40.3])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_taps_blur_as_much_as_a_box(width, share):
    taps = scenery.box_taps(width, np.array([3 + share]))
    n = np.arange(len(taps)) - len(taps) // 2
    assert taps.sum() == pytest.approx(1)
    assert (taps * n**2).sum() + share * (1 - share) == pytest.approx(width**2 / 12)
    np.testing.assert_allclose(taps, taps[::-1])


def test_a_surface_in_focus_is_not_filtered():
    one = scenery.cell_filter(0.0, cut(Aperture("square", 7, 5), 3), margin=4)
    for taps in (one.down, one.across):
        np.testing.assert_array_equal(taps, [0, 1, 0])
    np.testing.assert_array_equal(one.rows, [8, 8, 8])


def test_look_ups_move_by_the_relative_slope():
    cells = cut(Aperture("square", 4, 6), 3)
    one = scenery.cell_filter(-1.5, cells, margin=20)
    np.testing.assert_allclose(one.columns, 40 - 3 * cells.p.numpy())
    np.testing.assert_allclose(one.rows, 40 - 3 * cells.q.numpy())


def test_linear_look_ups_blur_by_what_filters_of_a_cell_leave_to_them():
    cells = cut(Aperture("square", 5, 5), 4)
    for e in (0.0, 0.3, 1.1):
        one = scenery.cell_filter(e, cells, margin=0)
        n = np.arange(len(one.down)) - len(one.down) // 2
        wanted = (2 * e * cells.height) ** 2 / 12
        (found,) = scenery.linear_variance(np.array([e]), cells)
        assert found + (one.down * n**2).sum() == pytest.approx(wanted)


def test_a_sum_of_look_ups_is_one_filter():
    random = np.random.default_rng(0)
    samples, positions, weights = random.random(40), np.array([12.25, 15.0, 19.9, 12.25]), random.random(4)
    taps = scenery.box_taps(3.3, positions)
    smooth = torch.from_numpy(np.convolve(samples, taps, mode="same"))
    whole = np.floor(positions).astype(int)
    share = positions - whole
    expected = (weights * ((1 - share) * smooth.numpy()[whole] + share * smooth.numpy()[whole + 1])).sum()
    first, summed = scenery.summed(taps, positions, weights)
    assert (summed * samples[first : first + len(summed)]).sum() == pytest.approx(expected)
