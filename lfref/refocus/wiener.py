"""Wiener refocusing: what a lens with the whole aperture would have photographed, estimated from its views.

Of all sums of filtered views it is the one of least mean square error over scenes with the given disparities. It
knows that a view stands for a cell of the aperture, so that wide blur has no copies; that pixels fold detail back,
which views at different fractions of a pixel tell apart; and that unlike disparities lie behind one another.
Source: Levin, Durand, "Linear view synthesis using a dimensionality gap light field prior", 2010.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier, jit, threads
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.wiener_filters import Pairs, Prior, filters, opposites

# PART sum_loop
# The loop, compiled by Numba, that adds up spectra of views times their factors.
#
# `LANES` frequencies of a row go through every step together, so that each step is one machine instruction for many.
# Letters: `n` plane, `p` sum or difference of opposite views, `j` picture (light field, channel and square), `y x`
# row and column of frequencies.

LANES = 16


@jit.compiled
def add_rows(
    spectra: NDArray, factors: NDArray, n_sums: int, first: int, last: int, made: NDArray
) -> None:  # pragma: no cover - compiled
    """Add up rows of frequencies from `first` to before `last`.

    Args:
        spectra: Pairs of real and imaginary part, [p, j, y, x, 2].
        factors: In whole lanes, [n, y, x lanes, p, LANES].
        n_sums: The first p that are sums; the factors of the others are times i.
        first: Row.
        last: One past the last row.
        made: Written to, [n, j, y, x, 2].
    """
    n_given, n_pictures, _, width, _ = spectra.shape
    real = np.zeros((n_pictures, n_given, LANES), spectra.dtype)
    imaginary = np.zeros((n_pictures, n_given, LANES), spectra.dtype)
    both = np.zeros((2, LANES), spectra.dtype)
    for y in range(first, last):
        for x in range(0, width, LANES):
            lanes = min(LANES, width - x)
            for p in range(n_given):
                for j in range(n_pictures):
                    for lane in range(lanes):
                        real[j, p, lane] = spectra[p, j, y, x + lane, 0]
                        imaginary[j, p, lane] = spectra[p, j, y, x + lane, 1]
            for n in range(factors.shape[0]):
                weights = factors[n, y, x // LANES]
                for j in range(n_pictures):
                    both[:] = 0
                    _add(real[j, :n_sums], weights[:n_sums], 1, both[0])
                    _add(imaginary[j, :n_sums], weights[:n_sums], 1, both[1])
                    _add(imaginary[j, n_sums:], weights[n_sums:], -1, both[0])
                    _add(real[j, n_sums:], weights[n_sums:], 1, both[1])
                    for lane in range(lanes):
                        made[n, j, y, x + lane, 0] = both[0, lane]
                        made[n, j, y, x + lane, 1] = both[1, lane]


@jit.compiled
def _add(values: NDArray, weights: NDArray, sign: int, total: NDArray) -> None:  # pragma: no cover - compiled
    """Add sign times the weighted sum of values [p, LANES] to a total [LANES], four at a time."""
    last = len(values) - len(values) % 4
    for p in range(0, last, 4):
        for lane in range(LANES):
            near = weights[p, lane] * values[p, lane] + weights[p + 1, lane] * values[p + 1, lane]
            far = weights[p + 2, lane] * values[p + 2, lane] + weights[p + 3, lane] * values[p + 3, lane]
            total[lane] += sign * (near + far)
    for p in range(last, len(values)):
        for lane in range(LANES):
            total[lane] += sign * weights[p, lane] * values[p, lane]


# PART tiles
# Filtering views in overlapping squares, so that filters of limited reach serve pictures of any size.
#
# Letters: `P` what is made of the views, `T` square.

WORTH_A_THREAD = 1 << 18
"""Values of a band's spectra from which one more thread saves more than it costs."""


def filtered(views: Tensor, pairs: Pairs, factors: Tensor, margin: int) -> Tensor:
    """Sums of filtered views.

    Args:
        views: Light fields, float32 or float64, views row by row, [B, V U, C, H, W].
        pairs: Of the views.
        factors: Of what they make of the views, [N, V U, side, side // 2 + 1].
        margin: Pixels around each square that it only reads.

    Returns:
        Stacks, [B, N, C, H, W].
    """
    side, size = factors.shape[-2], views.shape[-2:]
    step = side - 2 * margin
    counts = [-(-length // step) for length in size]
    down, across = (count * step + margin - length for count, length in zip(counts, size, strict=True))
    padded = F.pad(views.flatten(0, 2), (margin, across, margin, down), mode="replicate").reshape(
        *views.shape[:3], size[0] + margin + down, -1
    )
    stack = views.new_empty(len(views), len(factors), views.shape[2], counts[0] * step, counts[1] * step)
    for row in range(counts[0]):
        # One row of squares at a time: their spectra are all that is held.
        band = pairs.mixed(padded[..., row * step : row * step + side, :])
        made = _combined(torch.fft.rfft2(band.unfold(-1, side, step).movedim(-2, -3)), factors, pairs)
        inner = torch.fft.irfft2(made, s=(side, side))[..., margin : side - margin, margin : side - margin]
        stack[..., row * step : (row + 1) * step, :] = inner.movedim(-3, -2).flatten(-2)
    return stack[..., : size[0], : size[1]].contiguous()


def _combined(spectra: Tensor, factors: Tensor, pairs: Pairs) -> Tensor:
    """Spectra [B, V U, C, T, side, K] times their factors, added up, [B, N, C, T, side, K]."""
    given = spectra.transpose(0, 1)
    shape = (*given.shape[1:4], *given.shape[4:])
    add = _by_loop if batches.compiler_for(spectra, factors) == "numba" else _by_torch
    made = add(given.reshape(len(given), -1, *given.shape[4:]), factors, len(pairs.first))
    return made.unflatten(1, shape[:3]).transpose(0, 1)


def _by_loop(spectra: Tensor, factors: Tensor, n_sums: int) -> Tensor:
    """Spectra [V U, J, side, K] added up, [N, J, side, K]."""
    given = torch.view_as_real(spectra.resolve_conj().contiguous()).numpy()
    made = np.empty((len(factors), *given.shape[1:]), given.dtype)
    table = F.pad(factors, (0, -factors.shape[-1] % LANES)).unflatten(-1, (-1, LANES)).permute(0, 2, 3, 1, 4)
    n_threads = threads.worthwhile(made.size, WORTH_A_THREAD)
    jobs = (
        (given, table.contiguous().numpy(), n_sums, *band, made) for band in threads.bands(given.shape[2], n_threads)
    )
    threads.share(add_rows, jobs, n_threads)
    return torch.view_as_complex(torch.from_numpy(made))


def _by_torch(spectra: Tensor, factors: Tensor, n_sums: int) -> Tensor:
    """The same for whatever needs derivatives, and on a GPU."""
    parts = []
    for place, count in ((0, n_sums), (n_sums, len(spectra) - n_sums)):
        data = torch.view_as_real(spectra[place : place + count]).permute(2, 3, 0, 1, 4)
        weights = factors[:, place : place + count].permute(2, 3, 0, 1)
        parts.append(torch.matmul(weights, data.flatten(3)).unflatten(3, (-1, 2)))
    sums, differences = parts
    real, imaginary = sums[..., 0] - differences[..., 1], sums[..., 1] + differences[..., 0]
    return torch.complex(real, imaginary).permute(2, 3, 0, 1)


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
        >>> from lfref.refocus.wiener_filters import between
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
    stack = filtered(batch.flatten(1, 2), opposites(grid), factors.to(batch), margin)
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
