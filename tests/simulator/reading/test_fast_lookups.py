"""The compiled loops against PyTorch's operations, which are tested against closed forms in `test_lookups`."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.simulator.reading import fast_lookups, lookups

PIXELS = torch.arange(12, dtype=torch.float64) * 2


def grids(first_i, first_j, n_columns=9, n_rows=12):
    columns, rows = torch.tensor(first_i, dtype=torch.float64), torch.tensor(first_j, dtype=torch.float64)
    return columns[:, None, None] + PIXELS[:n_columns], (rows[:, None] + PIXELS[:n_rows])[..., None]


def bounded(height=40, width=46, channels=4):
    samples = torch.rand(channels, height, width)
    samples[:, [0, -1]] = 0
    samples[..., [0, -1]] = 0
    return samples


def test_shifts_that_stay_within_are_read_as_points_are():
    samples = torch.rand(4, 40, 46)
    i, j = grids([1.0, 2.3, 20.5], [1.0, 7.9, 13.2])
    assert fast_lookups.can_serve(samples, i, j)
    torch.testing.assert_close(fast_lookups.on_grid(samples, i, j), lookups.on_grid(samples, i, j), atol=1e-6, rtol=0)


@settings(deadline=None, max_examples=60)
@given(st.floats(-60, 100), st.floats(-60, 100), st.sampled_from([3, 4]))
def test_beyond_a_bitmap_that_ends_black_there_is_nothing(first_i, first_j, channels):
    samples = bounded(channels=channels)
    i, j = grids([first_i], [first_j])
    assert fast_lookups.can_serve(samples, i, j)
    torch.testing.assert_close(fast_lookups.on_grid(samples, i, j), lookups.on_grid(samples, i, j), atol=1e-6, rtol=0)


def test_what_is_no_row_of_pixels_or_goes_on_beyond_the_ends_is_not_served():
    samples = torch.rand(4, 40, 46)
    i, j = grids([3.0], [3.0])
    assert not fast_lookups.can_serve(samples, i * 1.001, j)
    assert not fast_lookups.can_serve(samples, i, j * 1.001)
    assert not fast_lookups.can_serve(samples, i - 3, j)
    assert not fast_lookups.can_serve(samples, i, j + 30)


def test_points_anywhere_are_read_as_by_pytorch():
    samples = torch.rand(4, 40, 46)
    i, j = torch.rand(2, 3, 11, 13, dtype=torch.float64) * 70 - 12
    interleaved = samples.movedim(0, -1).contiguous()
    torch.testing.assert_close(
        fast_lookups.anywhere(interleaved, i, j), lookups.anywhere(samples, i, j), atol=1e-6, rtol=0
    )


def test_outlines_leave_out_only_what_is_empty():
    samples = torch.zeros(4, 5, 8)
    samples[3, 1, 2:5] = 0.5
    samples[3, 3, 7] = 1
    sheet = fast_lookups.outlined(samples.numpy())
    assert [(b, e) for b, e in zip(sheet.begins, sheet.ends, strict=True) if b < e] == [(2, 5), (7, 8)]
    assert sheet.begins.tolist()[::2] == [8, 8, 8]
    assert fast_lookups.filled(samples.numpy()).ends.tolist() == [8] * 5
