"""What the loop of shifts takes: tables of whole and fractional shifts, and where bitmaps are not empty."""

import torch

from lfref.simulator import lookups
from lfref.simulator import shifts as shift_tables


def test_shifts_are_the_taps_and_weights_of_look_ups():
    first = torch.tensor([3.25, -0.5, 7.0], dtype=torch.float64)
    shifts = shift_tables.shifts(first)
    assert shifts.starts.tolist() == [2, -2, 6]
    torch.testing.assert_close(torch.from_numpy(shifts.weights), lookups.taps(first, 40)[1])


def test_outlines_leave_out_only_what_is_empty():
    samples = torch.zeros(4, 5, 8)
    samples[3, 1, 2:5] = 0.5
    samples[3, 3, 7] = 1
    sheet = shift_tables.outlined(samples.numpy())
    assert [(b, e) for b, e in zip(sheet.begins, sheet.ends, strict=True) if b < e] == [(2, 5), (7, 8)]
    assert sheet.begins.tolist()[::2] == [8, 8, 8]
    assert shift_tables.filled(samples.numpy()).ends.tolist() == [8] * 5
