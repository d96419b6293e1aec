"""Super-resolved refocusing: where views agree, they sample one surface between each other's pixels.

What is in focus is the picture on a finer grid that all views are samples of. Elsewhere there is no such picture, and
the plane of exact Fourier refocusing, brought to the finer grid without a change, is the better one. The views decide:
both pictures predict them, and the finer one is taken where its error is much smaller.

The finer picture is a ridge regression. Pixels of views are means over r x r fine pixels, shifted by the slope. At one
frequency k of the views meet r x r frequencies q = k + m of the fine picture F, mixed by each view with other phases:

    L^_i(k) = sum_q D(q) F^(q) exp(-2 pi i s i q) / r^2,   D the transform of the mean over r x r fine pixels.

Least squares over the views are a small system for every k, (D* G D + P) F^ / r^2 = D* E: E(q) is what exact Fourier
refocusing finds at q, the Gram matrix G depends only on how far two q lie apart, and the penalty P is the greater the
less power natural pictures have at q beside the lowest q. So the lowest one, which one view alone determines, is free.
Letters: `i` view, `v u` its row and column, `k` frequency in cycles per pixel of the views, `q` one of the fine
picture, `r` factor, `s` slope, `K` rows of frequencies at a time.
Source: Ur, Gross, "Improved resolution from subpixel shifted pictures", 1992 (folded frequencies as unknowns).
"""

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.fourier.exact import exact_fourier

RIDGE = 0.03
"""Penalty of a frequency as strong as the lowest, as a share of the views' whole weight: for light out of focus, which
no picture explains, rather than for noise."""
DECAY = 2.5
"""Power of natural pictures falls with frequency to this power."""
OUTER = 0.01
"""Cycles per pixel below which that power stays level."""
TIED = 1e-3
"""Penalty of lowest frequencies where several are: shares out what no view may tell apart."""
ENTRIES = 1 << 22
"""Entries of the matrices that are held at a time, 64 MB; the result does not depend on it."""
RADIUS = 4
"""Pixels around a pixel whose errors are compared."""
SURE, UNSURE = 0.2, 0.6
"""Share of the plane's squared error that is left to the finer picture: below all of it is taken, above nothing."""
LEAST_ERROR = 1e-7
"""Squared error, of views whose brightest pixel is 1, below which both pictures are as good: rounding of float32."""


def super_resolve(views: Tensor, slopes: Slopes, factor: int = 2, weights: Tensor | None = None) -> Tensor:
    """Refocus light fields onto a finer grid: more detail where they are in focus, `exact_fourier` elsewhere.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, taken as periodic, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N]; at whole slopes all views have the same samples, nothing is gained.
        factor: Fine pixels per pixel along each axis, r, >= 1.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, fine pixel X at
        x = (X + 1/2) / r - 1/2, [..., N, C, r H, r W].

    Raises:
        InputError: Views, slopes, factor or weights that cannot be used.

    Example:
        >>> lfref.super_resolve(torch.rand(5, 5, 3, 48, 64), [0.3], factor=2).shape
        torch.Size([1, 3, 96, 128])
    """
    check_factor(factor)
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.checked_weights(weights, grid)
    batch = batches.without_unread(batch, aperture)
    if batch.is_floating_point():
        batch = batch.to(batches.working_dtype(batch.dtype))  # half types are rounded once, at the end
    stack = band_limited(exact_fourier(batch, planes, aperture), factor)
    grey = torch.stack([batches.radiance(row).mean(2) for row in batch.unbind(1)], 1)
    brightest = grey.detach().abs().amax((1, 2, 3, 4)).clamp(min=torch.finfo(grey.dtype).tiny)[:, None, None]
    grey = grey / brightest[..., None, None]
    blends = []
    finer_pictures = pictures(batch, planes, factor, aperture)
    for slope, plane, fine in zip(planes.tolist(), stack.unbind(1), finer_pictures, strict=True):
        of_fine, of_plane = (
            _errors(grey, picture.mean(1) / brightest, slope, aperture, factor) for picture in (fine, plane)
        )
        share = ((UNSURE - of_fine / of_plane) / (UNSURE - SURE)).clamp(0, 1)
        blends.append(torch.lerp(plane, fine, F.interpolate(share, scale_factor=factor, mode="bilinear")))
    return batches.restored(torch.stack(blends, 1), views)


def _errors(views: Tensor, picture: Tensor, slope: float, aperture: Tensor, factor: int) -> Tensor:
    """Mean squared error [B, 1, H, W] of a picture [B, r H, r W] that predicts views, around each of its pixels.

    Views [B, V, U, H, W] and picture are grey, the brightest pixel of the views 1; the aperture [V, U] is of sum 1.
    """
    grid = (views.shape[1], views.shape[2])
    squares = (views - predicted_views(picture, slope, factor, grid)).square() * aperture.to(views)[:, :, None, None]
    down, across = ((-slope * geometry.angular_offsets(n)).round().long().tolist() for n in grid)
    # Each view's errors go back to the pixels of the picture that they come from.
    total = torch.zeros_like(squares[:, 0, 0])
    for v, y in enumerate(down):
        for u, x in enumerate(across):
            total = total + squares[:, v, u].roll((y, x), (-2, -1))
    around = F.pad(total[:, None], (RADIUS,) * 4, mode="replicate")
    return F.avg_pool2d(around, 2 * RADIUS + 1, 1) + LEAST_ERROR


def in_focus(views: Tensor, slopes: Slopes, factor: int = 2, weights: Tensor | None = None) -> Tensor:
    """The finer picture at each slope as if all the scene lay there; linear, the views taken as periodic.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        factor: Fine pixels per pixel along each axis, r, >= 1.
        weights: How much each view counts, >= 0, [V, U]; None counts all alike.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, fine pixel X at
        x = (X + 1/2) / r - 1/2 [..., N, C, r H, r W]. What is out of focus has false detail.

    Raises:
        InputError: Views, slopes, factor or weights that cannot be used.
    """
    check_factor(factor)
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes = geometry.checked_slopes(slopes, grid, size)
    stack = list(pictures(batch, planes, factor, batches.checked_weights(weights, grid)))
    return batches.restored(torch.stack(stack, 1), views)


def check_factor(factor: int) -> None:
    """Raise an InputError unless the factor is a whole number of fine pixels."""
    if not (isinstance(factor, int) and factor >= 1):
        raise InputError("factor must be a whole number of at least 1", got=repr(factor))


def pictures(views: Tensor, slopes: Tensor, factor: int, aperture: Tensor) -> Iterator[Tensor]:
    """The fine picture [B, C, r H, r W] of each slope, of views [B, V, U, C, H, W] weighed by an aperture of sum 1."""
    views, size = batches.without_unread(views, aperture), (views.shape[-2], views.shape[-1])
    planes = [_Regression(float(slope), factor, aperture, size) for slope in slopes]
    # E of every plane, [B, C, r, H, r, W].
    dtype = fourier.complex_dtype(batches.working_dtype(views.dtype))
    shape = (views.shape[0], views.shape[3], factor, size[0], factor, size[1])
    sums = [torch.zeros(shape, dtype=dtype, device=views.device) for _ in planes]
    for v, view_row in enumerate(views.unbind(1)):
        # One view row at a time: its spectra are all that is held beside the sums.
        spectra = torch.fft.fft2(batches.radiance(view_row))
        for n, plane in enumerate(planes):
            sums[n] = sums[n] + plane.row_sum(spectra, v)
    for plane in planes:
        yield _picture(plane.solved(sums.pop(0)))


def band_limited(stack: Tensor, factor: int) -> Tensor:
    """Pictures [..., H, W] on a finer grid without more detail, [..., r H, r W]; means over r x r give them back."""
    axes = []
    for length in stack.shape[-2:]:
        q = _frequencies(length, factor).abs()
        is_lowest = (q == q.amin(0)).double()
        axes.append(is_lowest / is_lowest.sum(0) / torch.where(is_lowest > 0, _mean(length, factor), 1))
    factors = (factor**2 * axes[0][:, :, None, None] * axes[1]).to(stack.device, fourier.complex_dtype(stack.dtype))
    return _picture(torch.fft.fft2(stack)[..., None, :, None, :] * factors)


def predicted_views(fine: Tensor, slope: float, factor: int, grid: tuple[int, int]) -> Tensor:
    """The views [..., V, U, H, W] of a periodic fine picture [..., r H, r W] that is in focus at the slope."""
    folds = torch.fft.fft2(fine).unflatten(-1, (factor, -1)).unflatten(-3, (factor, -1))  # r H r W
    rows, columns = (
        (_mean(length, factor) * _phases(length, factor, n_views, -slope) / factor).to(folds)
        for length, n_views in zip((folds.shape[-3], folds.shape[-1]), grid, strict=True)
    )
    across = torch.einsum("...ahbw,ubw->...uahw", folds, columns)
    return torch.fft.ifft2(torch.einsum("...uahw,vah->...vuhw", across, rows)).real


def _picture(spectrum: Tensor) -> Tensor:
    """The fine picture of a spectrum, [..., r, H, r, W] -> [..., r H, r W]."""
    return torch.fft.ifft2(spectrum.flatten(-2).flatten(-3, -2)).real


def _frequencies(length: int, factor: int) -> Tensor:
    """The q of every k, in cycles per pixel of the views, float64, [r, length]."""
    return (factor * fourier.frequencies(factor * length)).reshape(factor, length)


def _mean(length: int, factor: int) -> Tensor:
    """D(q) along one axis, complex128, [r, length]."""
    return _waves(_frequencies(length, factor)[..., None] * torch.arange(factor) / factor).mean(-1)


def _phases(length: int, factor: int, n_views: int, slope: float) -> Tensor:
    """exp(2 pi i s v q), complex128, [V, r, length]."""
    return _waves(slope * geometry.angular_offsets(n_views)[:, None, None] * _frequencies(length, factor))


def _waves(turns: Tensor) -> Tensor:
    """exp(2 pi i turns), complex128."""
    return torch.polar(torch.ones_like(turns), 2 * torch.pi * turns)


class _Regression:
    """The regression of one plane."""

    def __init__(self, slope: float, factor: int, aperture: Tensor, size: tuple[int, int]) -> None:
        self.factor, self.slope, self.aperture = factor, slope, aperture
        self.rows, self.columns = (_frequencies(length, factor).T for length in size)  # [length, r]
        self.means = [_mean(length, factor).T for length in size]
        self.phases = [_phases(n, factor, views, slope) for n, views in zip(size, aperture.shape, strict=True)]

    def row_sum(self, spectra: Tensor, v: int) -> Tensor:
        """What a row of views with spectra [B, U, C, H, W] adds to E."""
        columns = (self.phases[1] * self.aperture[v, :, None, None]).to(spectra)
        across = torch.einsum("buchw,urw->bchrw", spectra, columns)
        return across[:, :, None] * self.phases[0][v].to(spectra)[:, :, None, None]

    def solved(self, sums: Tensor) -> Tensor:
        """The spectrum of the fine picture, of E; both [B, C, r, H, r, W]."""
        step = max(1, ENTRIES // (self.factor**4 * sums.shape[-1]))
        spectra = []
        for first in range(0, sums.shape[3], step):
            part = slice(first, first + step)
            folded = sums[:, :, :, part].permute(3, 5, 2, 4, 0, 1)  # K W r r B C
            solution = self._solution(part).to(sums) @ folded.flatten(4).flatten(2, 3)
            spectra.append(solution.reshape(folded.shape).permute(4, 5, 2, 0, 3, 1))
        return torch.cat(spectra, 3)

    def _solution(self, part: slice) -> Tensor:
        """r^2 (D* G D + P)^-1 D*, which turns E into F^, at some rows of k, complex128, [K, W, r r, r r]."""
        mean = (self.means[0][part, None, :, None] * self.means[1][:, None]).flatten(2)
        squares = (self.rows[part, None, :, None].square() + self.columns[:, None].square()).flatten(2) + OUTER**2
        less_power = (squares / squares.amin(2, keepdim=True)).pow(DECAY / 2) - 1
        is_lowest = less_power < 1e-9
        penalty = RIDGE * less_power + TIED * (is_lowest & (is_lowest.sum(2, keepdim=True) > 1))
        matrix = mean.conj()[..., None] * self._gram(part) * mean[..., None, :] + torch.diag_embed(penalty)
        return self.factor**2 * torch.linalg.solve(matrix, torch.diag_embed(mean.conj()))

    def _gram(self, part: slice) -> Tensor:
        """G of every two q, sum_i w_i exp(2 pi i s i (q - q')), complex128, [K, W, r r, r r]."""
        lags = torch.arange(1 - self.factor, self.factor, dtype=torch.float64)  # q - q' is whole
        down, across = (_waves(self.slope * lags[:, None] * geometry.angular_offsets(n)) for n in self.aperture.shape)
        of_lags = down @ self.aperture.to(down) @ across.T
        rows, columns = (
            (q[:, :, None] - q[:, None]).round().long() + self.factor - 1 for q in (self.rows[part], self.columns)
        )
        return of_lags[rows[:, None, :, None, :, None], columns[:, None, :, None, :]].flatten(4).flatten(2, 3)
