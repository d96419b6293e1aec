"""The compiled loops against PyTorch's operations, which are tested against the definition in `test_batches`."""

import pytest
import torch

from lfref.refocus import batches, footprint
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.shift import shift_numba
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_bands import sum_by_bands
from lfref.refocus.shift.shifts import Shifts, shifts_of

SLOPES = [-2.3, -1.0, 0.0, 0.3, 0.5, 1.7]


def in_type(views: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    full_scale = {torch.uint8: 255, torch.uint16: 65535}.get(dtype)
    return (views * full_scale).to(dtype) if full_scale else views.to(dtype)


def both(views, slopes=SLOPES, interpolation="linear", border="renormalize", weights=None, widths=None):
    planes = batches.checked_slopes(slopes, views.shape[1:3], views.shape[-2:], None)
    method, rule = INTERPOLATIONS[interpolation], BORDERS[border]
    aperture = batches.checked_weights(weights, views.shape[1:3])
    shifts = shifts_of(planes, views.shape[1:3], method)
    boxes, widths = None, None if widths is None else torch.tensor(widths, dtype=torch.float64)
    if widths is not None:
        boxes = footprint.taps(widths, footprint.radius(float(widths.max())))
    in_working_type = aperture.to(batches.working_dtype(views.dtype))
    slow = sum_by_bands(views, Shifts(shifts.rows, shifts.columns, boxes), in_working_type, method, rule)
    return shift_numba.shift_and_sum(views, shifts, widths, aperture, method, rule), slow


@pytest.mark.parametrize("border", ["renormalize", "edge", "zero", "wrap"])
@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic"])
@pytest.mark.parametrize("dtype", [torch.float64, torch.uint8])
def test_equals_eager(border, interpolation, dtype):
    for grid, size in (((3, 4), (23, 30)), ((2, 9), (40, 33))):
        views = in_type(torch.rand(2, *grid, 2, *size, dtype=torch.float64), dtype)
        fast, slow = both(views, SLOPES[1:] if grid[1] == 9 else SLOPES, interpolation, border)
        assert fast.dtype == slow.dtype == (torch.float64 if dtype == torch.float64 else torch.float32)
        torch.testing.assert_close(fast, slow, atol=1e-12 if dtype == torch.float64 else 1e-6, rtol=0)


@pytest.mark.parametrize("border", ["renormalize", "edge", "zero", "wrap"])
@pytest.mark.parametrize("dtype", [torch.float64, torch.uint8])
def test_equals_eager_antialiased(border, dtype):
    views = in_type(torch.rand(2, 3, 4, 2, 23, 30, dtype=torch.float64), dtype)
    weights = torch.tensor([[0.0, 1, 0.5, 1]]).expand(3, 4)
    widths = [2.3, 0.0, 0.4, 0.3, 0.5, 17.0]
    fast, slow = both(views, SLOPES, "linear", border, weights, widths)
    torch.testing.assert_close(fast, slow, atol=1e-12 if dtype == torch.float64 else 2e-6, rtol=0)


@pytest.mark.parametrize("shape", [(1, 1, 1, 1, 1, 1), (1, 3, 3, 1, 5, 6), (2, 1, 9, 1, 4, 40), (1, 5, 2, 3, 9, 17)])
def test_rows_are_read_where_they_lie_without_leaving_the_memory_of_the_views(shape):
    # What lies before and after the views would turn sums into NaN.
    memory = torch.full((2 * torch.Size(shape).numel() + 200,), torch.nan)
    views = memory[100 : 100 + torch.Size(shape).numel()].view(shape).copy_(torch.rand(shape))
    slopes = [0.0, 0.3, -0.4] if shape[4] < 9 else [0.0, -1.7, 0.9]
    torch.testing.assert_close(*both(views, slopes), atol=1e-6, rtol=0)


def test_derivatives_are_taken_by_eager_operations(monkeypatch):
    monkeypatch.setattr(shift_numba, "shift_and_sum", pytest.fail)
    views = torch.rand(2, 2, 1, 6, 7, dtype=torch.float64)
    shift_and_sum(views.requires_grad_(), [0.3]).sum().backward()
    # Each pixel is a mean, so that moving all samples moves it as far.
    assert float(views.grad.sum()) == pytest.approx(views.shape[-2] * views.shape[-1])
    views = views.detach()
    torch.func.vmap(lambda x: shift_and_sum(x, [0.3]))(views[None])
