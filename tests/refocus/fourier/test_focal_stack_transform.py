"""All planes at once against plane by plane, on every kind of grid."""

import itertools

import pytest
import torch

from lfref import geometry
from lfref.errors import InputError
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.focal_stack_transform import at_slopes, focal_stack_transform


@pytest.mark.parametrize(
    ("grid", "size"),
    [
        *itertools.product([(3, 4)], [(16, 18), (15, 17)]),
        ((1, 5), (1, 20)),
        ((4, 1), (20, 1)),
    ],
)
@pytest.mark.parametrize("planes", [(1, -1.0, 0.4), (2, -1.0, 1.0), (5, 1.3, -0.4), (16, 0.2, 0.2), (33, -2.0, 2.0)])
def test_equals_exact_fourier_on_its_grid(grid, size, planes):
    # White noise has full energy at Nyquist, where even sizes go wrong first.
    views = torch.rand(*grid, 2, *size, dtype=torch.float64)
    weights = torch.rand(grid, dtype=torch.float64)
    expected = exact_fourier(views, geometry.even_slopes(*planes), weights)
    torch.testing.assert_close(focal_stack_transform(views, *planes, weights), expected, atol=1e-12, rtol=0)
    single = focal_stack_transform(views.float(), *planes, weights)
    torch.testing.assert_close(single.double(), expected, atol=1e-6, rtol=0)


def test_float32_holds_at_full_width_with_many_planes_and_large_slopes():
    # The phases of the chirps reach some 100 turns here.
    views = torch.rand(1, 7, 1, 2, 540, dtype=torch.float64)
    expected = exact_fourier(views, geometry.even_slopes(200, -7.0, 7.0))
    stack = focal_stack_transform(views.float(), 200, -7.0, 7.0)
    torch.testing.assert_close(stack.double(), expected, atol=1e-6, rtol=0)


def test_given_slopes_must_be_even():
    views = torch.rand(3, 3, 1, 12, 13, dtype=torch.float64)
    even = [0.8, 0.2, -0.4]
    torch.testing.assert_close(at_slopes(views, even), exact_fourier(views, even), atol=1e-12, rtol=0)
    torch.testing.assert_close(at_slopes(views, [0.3]), exact_fourier(views, [0.3]), atol=1e-12, rtol=0)
    for uneven in ([-0.4, 0.3, 0.8], []):
        with pytest.raises(InputError):
            at_slopes(views, uneven)
