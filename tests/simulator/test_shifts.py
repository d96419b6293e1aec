"""Shifted rows laid over pictures against NumPy; tables of shifts, and the visible part of bitmaps."""

import numpy as np
import pytest
import torch

from lfref.simulator import shifts
from lfref.simulator.shifts import ShiftTaps


def whole_shifts(starts):
    """Shifts by whole samples: the second of four samples is the pixel's own."""
    weights = np.tile(np.array([0, 1, 0, 0], np.float32), (len(starts), 1))
    return ShiftTaps(np.array(starts) - 1, weights)


@pytest.mark.parametrize("opaque", [False, True])
def test_whole_shifts_lay_every_other_sample_over_the_picture(opaque):
    random = np.random.default_rng(0)
    samples = random.random((4, 30, 40), np.float32)
    samples[:3] *= samples[3]
    sheet = shifts.untrimmed(samples[:3]) if opaque else shifts.trimmed(samples)
    picture = random.random((2, 3, 3, 10, 14), np.float32)
    columns, rows, expected = (0, 3, 11), (2, 9), picture.copy()
    for v, row in enumerate(rows):
        for u, column in enumerate(columns):
            part = samples[:, row : row + 20 : 2, column : column + 28 : 2]
            expected[v, u] = part[:3] + (0 if opaque else (1 - part[3]) * expected[v, u])
    for top, end in ((0, 4), (4, 10)):
        shifts.composite_shifted(sheet, whole_shifts(columns), whole_shifts(rows), picture, top, end)
    np.testing.assert_allclose(picture, expected, atol=1e-6)


def test_nothing_is_laid_where_the_sheet_is_empty_or_ends():
    samples = np.zeros((4, 12, 12), np.float32)
    samples[:, 4:8, 4:8] = 1
    picture = np.full((1, 5, 3, 12, 12), 0.5, np.float32)
    starts = (-30, -8, 0, 5, 40)
    shifts.composite_shifted(shifts.trimmed(samples), whole_shifts(starts), whole_shifts([0]), picture, 0, 12)
    for u, start in enumerate(starts):
        columns = [x for x in range(12) if 4 <= start + 2 * x < 8]
        expected = np.full((12, 12), 0.5)
        expected[np.ix_([2, 3], columns)] = 1
        np.testing.assert_allclose(picture[0, u, 0], expected)


def test_overshoot_of_the_cubic_is_cut_and_keeps_the_colour():
    samples = np.zeros((4, 12, 12), np.float32)
    samples[3, :, 6:] = 1
    samples[:3, :, 6:] = 0.6
    half = ShiftTaps(np.array([0]), np.array([[-0.0625, 0.5625, 0.5625, -0.0625]], np.float32))
    picture = np.full((1, 1, 3, 4, 4), 0.6, np.float32)
    shifts.composite_shifted(shifts.trimmed(samples), half, whole_shifts([2]), picture, 0, 4)
    np.testing.assert_allclose(picture, 0.6, atol=1e-6)


def test_outlines_leave_out_only_what_is_empty():
    samples = torch.zeros(4, 5, 8)
    samples[3, 1, 2:5] = 0.5
    samples[3, 3, 7] = 1
    sheet = shifts.trimmed(samples.numpy())
    assert [(b, e) for b, e in zip(sheet.begins, sheet.ends, strict=True) if b < e] == [(2, 5), (7, 8)]
    assert sheet.begins.tolist()[::2] == [8, 8, 8]
    assert shifts.untrimmed(samples.numpy()).ends.tolist() == [8] * 5
