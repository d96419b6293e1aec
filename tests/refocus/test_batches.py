"""Weights become an aperture of sum 1; any batch dimensions pass through an operator, integers become radiance."""

import functools
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.refocus import batches
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocus.surface import homography, per_pixel, tilt_shift
from tests.refocus.conftest import dirichlet, slope_homographies
from tests.refocus.slow import slow_shift_and_sum

GRID, SIZE, SLOPES = (3, 4), (14, 17), [-1.3, 0.0, 0.41, 1.0]


def uneven(kind: str, grid: tuple[int, int] = GRID) -> Tensor:
    """Positions that are even, differ by row and column only, by the view in its row, or any way."""
    offsets = [geometry.angular_offsets(n) for n in grid]
    stand, generator = torch.stack(torch.meshgrid(*offsets, indexing="ij"), -1), torch.Generator().manual_seed(3)
    noise = 0.4 * torch.rand(*grid, 2, dtype=torch.float64, generator=generator) - 0.2
    if kind == "separable":
        noise[..., 0], noise[..., 1] = noise[:, :1, 0], noise[:1, :, 1]
    if kind == "rows":
        noise[..., 0] = noise[:, :1, 0]
    return stand + (0 if kind == "even" else noise)


KINDS = ["even", "separable", "rows", "general"]
each_kind = pytest.mark.parametrize("kind", KINDS)


@each_kind
@pytest.mark.parametrize("border", ["renormalize", "edge", "zero", "wrap"])
@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic"])
def test_shift_and_sum_equals_the_slow_reference(kind, interpolation, border):
    views, weights = torch.rand(*GRID, 1, 6, 7, dtype=torch.float64), torch.rand(GRID, dtype=torch.float64)
    weights[1, 2] = 0
    positions = uneven(kind)
    stack = shift_and_sum(views, SLOPES, interpolation, border, weights, positions=positions)
    differentiated = shift_and_sum(views.requires_grad_(), SLOPES, interpolation, border, weights, positions=positions)
    torch.testing.assert_close(differentiated.detach(), stack, atol=1e-12, rtol=0)
    for image, slope in zip(stack, SLOPES, strict=True):
        expected = slow_shift_and_sum(views.detach(), slope, interpolation, border, weights, positions)
        torch.testing.assert_close(image, expected, atol=1e-12, rtol=0)


@settings(deadline=None, max_examples=40)
@given(st.data())
def test_compiled_loops_equal_eager_operations_wherever_cameras_stand(data):
    grid = data.draw(st.tuples(st.integers(1, 5), st.integers(1, 5)))
    size = data.draw(st.tuples(st.integers(1, 20), st.integers(1, 40)))
    positions = uneven(data.draw(st.sampled_from(KINDS)), grid) * data.draw(st.floats(0, 1))
    extent = batches.lines(grid, positions).extent
    steepest = min((n / (m - 1) for n, m in zip(size, extent, strict=True) if m > 1), default=3)
    slopes = [0.99 * steepest * share for share in data.draw(st.lists(st.floats(-1, 1), min_size=1, max_size=3))]
    weights = torch.randint(0, 3, grid, generator=torch.Generator().manual_seed(data.draw(st.integers(0, 99))))
    weights[0, 0] += weights.sum() == 0
    border = data.draw(st.sampled_from(["renormalize", "edge", "zero"]))
    interpolation = data.draw(st.sampled_from(["nearest", "linear", "cubic"]))
    views = torch.rand(*grid, 1, *size, dtype=torch.float64)
    read = functools.partial(
        shift_and_sum, slopes=slopes, interpolation=interpolation, border=border, weights=weights, positions=positions
    )
    torch.testing.assert_close(read(views), read(views.requires_grad_()).detach(), atol=1e-12, rtol=0)


@each_kind
@pytest.mark.parametrize("size", [(16, 18), (15, 17), (16, 17)])
def test_exact_refocusing_reads_every_view_by_its_own_phases(kind, size):
    # White noise has full energy at Nyquist, where even sizes go wrong first.
    views, positions = torch.rand(*GRID, 1, *size, dtype=torch.float64), uneven(kind)
    weights = torch.rand(GRID, dtype=torch.float64)
    expected = torch.zeros(len(SLOPES), 1, *size, dtype=torch.float64)
    for image, slope in zip(expected, SLOPES, strict=True):
        for v, u in torch.ones(GRID).nonzero().tolist():
            row, column = (dirichlet(n, slope * float(p)) for n, p in zip(size, positions[v, u], strict=True))
            image += weights[v, u] / weights.sum() * (row @ views[v, u] @ column.T)
    stack = exact_fourier(views, SLOPES, weights, positions=positions)
    torch.testing.assert_close(stack, expected, atol=1e-12, rtol=0)


@each_kind
def test_all_that_take_cameras_anywhere_agree(kind):
    views, positions = torch.rand(*GRID, 2, *SIZE, dtype=torch.float64), uneven(kind)
    expected = shift_and_sum(views, SLOPES, positions=positions)
    maps = torch.tensor(SLOPES, dtype=torch.float64)[:, None, None].expand(-1, *SIZE)
    for stack in (
        per_pixel(views, maps, positions=positions),
        per_pixel(views.clone().requires_grad_(), maps, positions=positions).detach(),
        tilt_shift(views, SLOPES, (0, 0), positions=positions),
        homography(views, slope_homographies(SLOPES, positions)),
    ):
        torch.testing.assert_close(stack, expected, atol=1e-12, rtol=0)
    still, slopes = views[:1, :1].expand_as(views), [-0.9, 0.0, 0.41]
    torch.testing.assert_close(
        shift_and_sum_antialiased(still, slopes, positions=positions),
        shift_and_sum(still, slopes, "spline", positions=positions),
    )


@pytest.mark.parametrize("values", [[[1e-300] * 3] * 2, [[1e308] * 3] * 2, [[1.0, 2, 3], [0, 1e-6, 5]]])
def test_weights_are_scaled_to_a_sum_of_1_and_keep_their_ratios(values):
    weights = torch.tensor(values, dtype=torch.float64)
    aperture = batches.checked_weights(weights, (2, 3))
    assert float(aperture.sum()) == pytest.approx(1, abs=1e-12)
    torch.testing.assert_close(aperture * weights.amax(), weights * aperture.amax(), rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    "change",
    [
        {"weights": torch.ones(4, 3)},
        {"weights": torch.zeros(3, 4)},
        {"weights": torch.full((3, 4), math.nan)},
        {"positions": torch.zeros(3, 3, 2)},
        {"positions": torch.full((3, 4, 2), torch.nan)},
        {"positions": uneven("even") * 9},
    ],
)
def test_weights_and_positions_that_cannot_be_used_are_refused(change):
    with pytest.raises(InputError):
        shift_and_sum(torch.rand(*GRID, 1, *SIZE), [1.0], **change)
