"""Wiener refocusing: what a lens with the whole aperture would have photographed, estimated from its views.

Of all sums of filtered views, `I_s = sum_i g_si * L_i`, it is the one of least mean square error over scenes with the
given disparities (`wiener_filters` solves for the g). It knows that a view stands for a cell of the aperture, so that
wide blur has no copies; that pixels fold detail back, which views at different fractions of a pixel tell apart; and
that light of several disparities is mixed. The steps:

1. Solve for filters of limited reach, as factors of the frequencies of one square of pixels.
2. Cut the views into squares that overlap by twice that reach, one row of squares at a time.
3. Transform the sums and differences of opposite views, some pairs at a time: for these the factors are real.
4. Add up the spectra times their factors.
5. Transform back; the inner part of each square is the picture there.
Filters of `separable_wiener` are products of rows and columns; these are not: they tell more disparities apart, and
take longer.

Letters: `B` light fields, `N` planes, `T` squares of a row, `J` all of their pictures, `K` columns of frequencies.
Source: Levin, Durand, "Linear view synthesis using a dimensionality gap light field prior", 2010.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.functional import fft_lengths, loops
from lfref.functional.loops import LANES
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.fourier import exact
from lfref.refocus.wiener_filters import Pairs, Prior, filters, opposites, prior_of_map

TAIL = 12
"""Pixels that filters reach beyond the shifts of the views."""
AT_ONCE = 2**24
"""Samples of all views in the squares whose spectra are held at once, 64 MB."""
MIXED_AT_ONCE = 2**20
"""Samples of the pairs that are mixed and transformed at once, 4 MB, about what caches hold; some copies are needed."""


def wiener(views: Tensor, slopes: Slopes, prior: Prior | None = None, weights: Tensor | None = None) -> Tensor:
    """Refocus light fields by the linear estimate of least mean square error.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        prior: Which disparities the scene has; None takes those of each light field's own disparity map.
        weights: Synthetic aperture of the photograph, >= 0, symmetric about both axes, [V, U]; each view stands for its
            cell of it. Views of weight 0 are read too. None: the whole square.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes or weights that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.wiener(views, [-0.5, 0.5]).shape
        torch.Size([2, 3, 48, 64])
    """
    batch = batches.radiance(batches.flattened(views))
    grid, size = batches.grid_and_size(batch)
    planes = geometry.checked_slopes(slopes, grid, size)
    aperture = batches.symmetric_weights(weights, grid)
    # Filters are solved for in a square of twice the margin, in which FFTs are fast: what lies beyond would be cut off.
    margin = fft_lengths.next_fast_even(2 * math.ceil(max(geometry.corner_shift(planes, grid), 2.0)) + 2 * TAIL) // 2
    side = _side(margin, size)
    by_loop = batches.is_compiled(batch)
    stacks = []
    for field in [batch] if prior else batch.split(1):  # without a prior, each light field has its own
        known = prior or prior_of_map(coarse_disparity(field[0]))
        factors = filters(known, tuple(planes.tolist()), grid, tuple(map(tuple, aperture.tolist())), margin, side)
        table = batch.new_empty(len(planes), *_table_shape(grid[0] * grid[1], side, by_loop))
        for place, plane in zip(table, factors, strict=True):
            place.copy_(_lanes(plane) if by_loop else plane)
        stacks.append(_filtered(field.flatten(1, 2), opposites(grid), table, side, margin, by_loop))
    return batches.restored(torch.cat(stacks), views)


def _side(margin: int, size: tuple[int, int]) -> int:
    """Side of the squares that take the least work: filters for one of them (about 3 FFTs), and FFTs for all."""
    sides = (96, 128, 160, 192, 256, 320, 384, 512, fft_lengths.next_fast_even(max(size) + 2 * margin))

    def work(side: int) -> float:
        n_squares = math.prod(math.ceil(length / (side - 2 * margin)) for length in size)
        return (3 + n_squares) * side**2

    return min((side for side in sides if side > 2 * margin + 8), key=work)


def _filtered(views: Tensor, pairs: Pairs, table: Tensor, side: int, margin: int, by_loop: bool) -> Tensor:
    """Sums of filtered views.

    Args:
        views: Light fields, views row by row, [B, V U, C, H, W].
        pairs: Opposite views.
        table: `filters` of all planes, [N, V U, side, side // 2 + 1], or their `_lanes` if the loop serves.
        side: Of the squares, in pixels.
        margin: Pixels around each square that are read but not written.
        by_loop: Whether the compiled loop serves.

    Returns:
        Stacks, [B, N, C, H, W].
    """
    size = views.shape[-2:]
    step = side - 2 * margin
    counts = [-(-length // step) for length in size]
    n_squares = max(1, AT_ONCE // (math.prod(views.shape[:3]) * side**2))
    stack = views.new_empty(len(views), len(table), views.shape[2], *size)
    # Some squares of a row at a time: the spectra of all would take many times the memory of the views.
    for row in range(counts[0]):
        for first in range(0, counts[1], n_squares):
            last = min(first + n_squares, counts[1])
            left = first * step - margin
            spectra = _spectra(views, pairs, (row * step - margin, left), last - first, side, step)
            total = (_by_loop if by_loop else _by_torch)(spectra.flatten(1, 3), table, len(pairs.first))
            total = total.unflatten(1, spectra.shape[1:4]).transpose(0, 1)
            inner = torch.fft.irfft2(total, s=(side, side))[..., margin : side - margin, margin : side - margin]
            place = stack[..., row * step : (row + 1) * step, first * step : last * step]
            # The last squares reach beyond the picture.
            place.copy_(inner.movedim(-3, -2).flatten(-2)[..., : place.shape[-2], : place.shape[-1]])
    return stack


def _spectra(views: Tensor, pairs: Pairs, corner: tuple[int, int], n_squares: int, side: int, step: int) -> Tensor:
    """Spectra of sums of opposite views, of the central view, and of differences, in squares `step` pixels apart.

    Args:
        views: Light fields, views row by row, [B, V U, C, H, W].
        pairs: Opposite views.
        corner: Row and column of the first square's first pixel; beyond the views the outermost pixels are repeated.
        n_squares: Number of squares T, side by side.
        side: Of the squares, in pixels.
        step: From square to square, in pixels.

    Returns:
        Complex, [V U, B, C, T, side, side // 2 + 1].
    """
    n_fields, n_views, n_channels = views.shape[:3]
    shape = (n_views, n_fields, n_channels, n_squares, side, side // 2 + 1)
    spectra = views.new_empty(shape, dtype=exact.complex_dtype(views.dtype))
    (top, left), width = corner, (n_squares - 1) * step + side
    beyond = (max(-left, 0), max(left + width - views.shape[-1], 0), max(-top, 0), max(top + side - views.shape[-2], 0))
    within = views[..., max(top, 0) : top + side, max(left, 0) : left + width]

    def transform(mixed: Tensor, first: int) -> None:
        padded = F.pad(mixed.flatten(0, 2), beyond, mode="replicate").unflatten(0, mixed.shape[:3])
        squares = padded.unfold(-1, side, step).movedim(-2, -3)
        spectra[first : first + mixed.shape[1]] = torch.fft.rfft2(squares).transpose(0, 1)

    n_sums = len(pairs.first)
    n_at_once = max(1, MIXED_AT_ONCE // (n_fields * n_channels * side * width))
    for first in range(0, pairs.n_pairs, n_at_once):
        last = min(first + n_at_once, pairs.n_pairs)
        one, other = within[:, first:last], within[:, n_views - last : n_views - first].flip(1)
        transform(one + other, first)
        transform(one - other, n_sums + first)
    if pairs.n_pairs < n_sums:
        transform(within[:, pairs.n_pairs : n_sums], pairs.n_pairs)
    return spectra


def _table_shape(n_views: int, side: int, by_loop: bool) -> tuple[int, ...]:
    width = side // 2 + 1
    return (side, -(-width // LANES), n_views, LANES) if by_loop else (n_views, side, width)


def _lanes(factors: Tensor) -> Tensor:
    """Factors of a plane [V U, side, K] with those of one lane together, [y, x lanes, p, LANES]."""
    return F.pad(factors, (0, -factors.shape[-1] % LANES)).unflatten(-1, (-1, LANES)).permute(1, 2, 0, 3)


def _by_loop(spectra: Tensor, table: Tensor, n_sums: int) -> Tensor:
    """Spectra [V U, J, side, K] times `_lanes` of factors, added up, [N, J, side, K]; times i after `n_sums`."""
    pairs = torch.view_as_real(spectra.resolve_conj().contiguous()).numpy()
    total = np.empty((len(table), *pairs.shape[1:]), pairs.dtype)
    lanes = table.numpy()
    n_threads = loops.worthwhile(total.size, 1 << 18)  # numbers from which one more thread pays
    jobs = ((pairs, lanes, n_sums, *band, total) for band in loops.bands(pairs.shape[2], n_threads))
    loops.share(add_rows, jobs, n_threads)
    return torch.view_as_complex(torch.from_numpy(total))


def _by_torch(spectra: Tensor, factors: Tensor, n_sums: int) -> Tensor:
    """`_by_loop` in PyTorch: it has derivatives, and runs on a GPU."""
    parts = []
    for first, count in ((0, n_sums), (n_sums, len(spectra) - n_sums)):
        data = torch.view_as_real(spectra[first : first + count]).permute(2, 3, 0, 1, 4)
        weights = factors[:, first : first + count].permute(2, 3, 0, 1)
        parts.append(torch.matmul(weights, data.flatten(3)).unflatten(3, (-1, 2)))
    sums, differences = parts
    real, imaginary = sums[..., 0] - differences[..., 1], sums[..., 1] + differences[..., 0]
    return torch.complex(real, imaginary).permute(2, 3, 0, 1)


@loops.compiled
def add_rows(
    spectra: NDArray, factors: NDArray, n_sums: int, first: int, last: int, total: NDArray
) -> None:  # pragma: no cover - compiled
    """Rows of frequencies from `first` to before `last`: spectra [p, j, y, x, 2] to a total [n, j, y, x, 2].

    `n` plane, `p` sum or difference of opposite views, `j` picture (light field, channel and square), `y x` row and
    column of frequencies; factors are [n, y, x lanes, p, LANES], real for the first `n_sums` p, then times i.
    """
    n_mixed, n_pictures, _, width, _ = spectra.shape
    # Zeros, not empty: the last lane of a row may be short, and what lies beyond it is added up as well.
    real = np.zeros((n_pictures, n_mixed, LANES), spectra.dtype)
    imaginary = np.zeros((n_pictures, n_mixed, LANES), spectra.dtype)
    both = np.zeros((2, LANES), spectra.dtype)
    for y in range(first, last):
        for x in range(0, width, LANES):
            lanes = min(LANES, width - x)
            # Real and imaginary parts are gathered once, and serve all planes.
            for p in range(n_mixed):
                for j in range(n_pictures):
                    for lane in range(lanes):
                        real[j, p, lane] = spectra[p, j, y, x + lane, 0]
                        imaginary[j, p, lane] = spectra[p, j, y, x + lane, 1]
            for n in range(factors.shape[0]):
                weights = factors[n, y, x // LANES]
                for j in range(n_pictures):
                    both[:] = 0
                    # Factors of sums are real; those of differences are times i, which swaps the parts.
                    _add(real[j, :n_sums], weights[:n_sums], 1, both[0])
                    _add(imaginary[j, :n_sums], weights[:n_sums], 1, both[1])
                    _add(imaginary[j, n_sums:], weights[n_sums:], -1, both[0])
                    _add(real[j, n_sums:], weights[n_sums:], 1, both[1])
                    for lane in range(lanes):
                        total[n, j, y, x + lane, 0] = both[0, lane]
                        total[n, j, y, x + lane, 1] = both[1, lane]


@loops.compiled
def _add(values: NDArray, weights: NDArray, sign: int, total: NDArray) -> None:  # pragma: no cover - compiled
    """Add sign times the weighted sum of values [p, LANES] to a total [LANES], read and written once for four p."""
    last = len(values) - len(values) % 4
    for p in range(0, last, 4):
        for lane in range(LANES):
            near = weights[p, lane] * values[p, lane] + weights[p + 1, lane] * values[p + 1, lane]
            far = weights[p + 2, lane] * values[p + 2, lane] + weights[p + 3, lane] * values[p + 3, lane]
            total[lane] += sign * (near + far)
    for p in range(last, len(values)):
        for lane in range(LANES):
            total[lane] += sign * weights[p, lane] * values[p, lane]
