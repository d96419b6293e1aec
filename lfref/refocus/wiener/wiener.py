"""Wiener refocusing: what a lens with the whole aperture would have photographed, estimated from its views.

Of all sums of filtered views it is the one of least mean square error over scenes with the given disparities. It
knows that a view stands for a cell of the aperture, so that wide blur has no copies; that pixels fold detail back,
which views at different fractions of a pixel tell apart; and that unlike disparities lie behind one another.
Source: Levin, Durand, "Linear view synthesis using a dimensionality gap light field prior", 2010.
"""

import math

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.wiener import tiles
from lfref.refocus.wiener.filters import filters, opposites
from lfref.refocus.wiener.prior import Prior

TAIL = 12
"""Pixels that filters reach beyond the shifts of the views."""
SIDES = (96, 128, 160, 192, 256, 320, 384, 512)


def wiener(views: Tensor, slopes: Slopes, prior: Prior, weights: Tensor | None = None) -> Tensor:
    """Refocus light fields by the linear estimate of least mean square error.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        prior: Which disparities the scene has.
        weights: Synthetic aperture of the photograph, >= 0, alike on both sides of both axes, [V, U]; each view stands
            for its cell of it. Views of weight 0 are read too. None: the whole square.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes or weights that cannot be used.

    Example:
        >>> from lfref.refocus.wiener.prior import between
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.wiener(views, [-0.5, 0.5], between(-1, 0.5)).shape
        torch.Size([2, 3, 48, 64])
    """
    batch = batches.radiance(batches.flattened(views))
    grid, size = batches.grid_and_size(batch)
    planes = geometry.checked_slopes(slopes, grid, size)
    aperture = checked_aperture(weights, grid)
    # Filters are found in a square in which FFTs are fast, and no larger: what is beyond half of it would be cut off.
    margin = fourier.next_fast_even(2 * math.ceil(max(geometry.corner_shift(planes, grid), 2.0)) + 2 * TAIL) // 2
    side = _side(margin, size)
    factors = filters(prior, tuple(planes.tolist()), grid, tuple(map(tuple, aperture.tolist())), margin, side)
    stack = tiles.filtered(batch.flatten(1, 2), opposites(grid), factors.to(batch), margin)
    return batches.restored(stack, views)


def checked_aperture(weights: Tensor | None, grid: tuple[int, int]) -> Tensor:
    """The aperture as weights that sum to 1, once it is known to be one that filters can be made for.

    Args:
        weights: As of `wiener`.
        grid: Number of view rows and columns (V, U).

    Returns:
        Float64, CPU, [V, U].

    Raises:
        InputError: Weights that cannot be used.
    """
    aperture = batches.checked_weights(weights, grid)
    if not (torch.allclose(aperture, aperture.flip(0)) and torch.allclose(aperture, aperture.flip(1))):
        raise InputError(
            "weights must be alike on both sides of both axes",
            got="others",
            remedy="take method=shift_and_sum_through_cells",
        )
    return aperture


def _side(margin: int, size: tuple[int, int]) -> int:
    """Side of the squares that take the least work: filters to be found for one, FFTs for all of them."""

    def work(side: int) -> float:
        n_squares = math.prod(math.ceil(length / (side - 2 * margin)) for length in size)
        return (3 + n_squares) * side**2

    sides = {*SIDES, fourier.next_fast_even(max(size) + 2 * margin)}
    return min((side for side in sides if side > 2 * margin + 8), key=work)
