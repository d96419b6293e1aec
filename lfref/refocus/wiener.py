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

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.functional import fft_lengths
from lfref.refocus import batches
from lfref.refocus.fourier import exact
from lfref.refocus.wiener_filters import Prior, filters, opposites

TAIL = 12
"""Pixels that filters reach beyond the shifts of the views."""
AT_ONCE = 2**24
"""Samples of all views in the squares whose spectra are held at once, 64 MB."""
MIXED_AT_ONCE = 2**20
"""Samples of the pairs that are mixed and transformed at once, 4 MB, about what caches hold; some copies are needed."""


def refocus_jointly(field: Tensor, planes: Tensor, prior: Prior, aperture: Tensor) -> Tensor:
    """A light field [V, U, C, H, W] refocused at planes [N] by filters of all views together, [N, C, H, W].

    The aperture [V, U], of sum 1, is symmetric about both axes.
    """
    grid, size = batches.grid_and_size(field)
    # Filters are solved for in a square of twice the margin, in which FFTs are fast: what lies beyond would be cut off.
    margin = fft_lengths.next_fast_even(2 * math.ceil(max(geometry.corner_shift(planes, grid), 2.0)) + 2 * TAIL) // 2
    side = _side(margin, size)
    factors = filters(prior, tuple(planes.tolist()), grid, tuple(map(tuple, aperture.tolist())), margin, side)
    table = field.new_empty(len(planes), grid[0] * grid[1], side, side // 2 + 1)
    for place, plane in zip(table, factors, strict=True):
        place.copy_(plane)
    return _filtered(field[None].flatten(1, 2), table, side, margin)[0]


def _side(margin: int, size: tuple[int, int]) -> int:
    """Side of the squares that take the least work: filters for one of them (about 3 FFTs), and FFTs for all."""
    sides = (96, 128, 160, 192, 256, 320, 384, 512, fft_lengths.next_fast_even(max(size) + 2 * margin))

    def work(side: int) -> float:
        n_squares = math.prod(math.ceil(length / (side - 2 * margin)) for length in size)
        return (3 + n_squares) * side**2

    return min((side for side in sides if side > 2 * margin + 8), key=work)


def _filtered(views: Tensor, table: Tensor, side: int, margin: int) -> Tensor:
    """Sums [B, N, C, H, W] of views [B, V U, C, H, W], filtered in squares by the `filters` of all planes.

    Of each square of `side` pixels, `margin` pixels at each border are read but not written.
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
            spectra = _spectra(views, (row * step - margin, left), last - first, side, step)
            total = _mixed(spectra.flatten(1, 3), table, opposites(views.shape[1])[0])
            total = total.unflatten(1, spectra.shape[1:4]).transpose(0, 1)
            inner = torch.fft.irfft2(total, s=(side, side))[..., margin : side - margin, margin : side - margin]
            place = stack[..., row * step : (row + 1) * step, first * step : last * step]
            # The last squares reach beyond the picture.
            place.copy_(inner.movedim(-3, -2).flatten(-2)[..., : place.shape[-2], : place.shape[-1]])
    return stack


def _spectra(views: Tensor, corner: tuple[int, int], n_squares: int, side: int, step: int) -> Tensor:
    """Spectra of sums of opposite views, of the central view, and of differences, [V U, B, C, T, side, side // 2 + 1].

    T squares lie side by side, `step` pixels apart, the first pixel of the first one at `corner` of the views
    [B, V U, C, H, W]; beyond the views, the outermost pixels are repeated.
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

    n_sums, n_pairs = opposites(n_views)
    n_at_once = max(1, MIXED_AT_ONCE // (n_fields * n_channels * side * width))
    for first in range(0, n_pairs, n_at_once):
        last = min(first + n_at_once, n_pairs)
        one, other = within[:, first:last], within[:, n_views - last : n_views - first].flip(1)
        transform(one + other, first)
        transform(one - other, n_sums + first)
    if n_pairs < n_sums:
        transform(within[:, n_pairs:n_sums], n_pairs)
    return spectra


def _mixed(spectra: Tensor, table: Tensor, n_sums: int) -> Tensor:
    """Spectra [V U, J, side, K] times factors [N, V U, side, K], added up, [N, J, side, K]; times i after `n_sums`."""
    parts, stack = torch.view_as_real(spectra).movedim(-1, 1).contiguous(), []
    for factors in table:
        sums, differences = torch.zeros_like(parts[0]), torch.zeros_like(parts[0])
        for p, (part, factor) in enumerate(zip(parts, factors, strict=True)):
            (sums if p < n_sums else differences).addcmul_(part, factor)
        stack.append(torch.complex(sums[0] - differences[1], sums[1] + differences[0]))
    return torch.stack(stack)
