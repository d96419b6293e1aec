"""Super-resolved refocusing: where views agree, they sample one surface between each other's pixels.

What is in focus is the picture on a finer grid that all views are samples of. Elsewhere there is no such picture, and
the plane of exact Fourier refocusing, brought to the finer grid without a change, is the better one. The views decide:
both pictures predict them, and the finer one is taken where its error is much smaller.

The finer picture is a ridge regression. Pixels of views are means over r x r fine pixels, shifted by the slope. At one
frequency k of the views meet r x r frequencies q = k + m of the fine picture F, mixed by each view with other phases:

    L^_i(k) = sum_q D(q) F^(q) exp(-2 pi i s i q) / r^2,   D the transform of the mean over r x r fine pixels.

Least squares over the views are a small system for every k, (D* G D + P) F^ / r^2 = D* E: E(q) is what exact Fourier
refocusing finds at q, the Gram matrix G depends only on how far two q lie apart, and P(q) = RIDGE (S(q0) / S(q) - 1) is
the penalty. S is the power of natural pictures, as in `axis_filters`; q0 is the lowest q, which one view alone
determines: it is free.

Letters: `i` view, `v u` its row and column, `k` frequency in cycles per pixel of the views, `q` one of the fine
picture, `r` factor, `s` slope, `K` rows of frequencies at a time.
Source: Ur, Gross, "Improved resolution from subpixel shifted pictures", 1992 (folded frequencies as unknowns).
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.axis_filters import DECAY, OUTER
from lfref.refocus.fourier.exact import exact_fourier

RIDGE = 0.03
"""Penalty of a frequency as strong as the lowest, as a share of the views' whole weight: for light out of focus, which
no picture explains, rather than for noise."""
TIED = 1e-3
"""Penalty of the lowest frequencies where there are several, as a share of the views' whole weight."""
RADIUS = 4
"""Pixels around a pixel whose errors are compared."""
SURE, UNSURE = 0.2, 0.6
"""Share of the plane's squared error that is left to the finer picture: below all of it is taken, above nothing."""
LEAST_ERROR = 1e-7
"""Squared error, of views whose brightest pixel is 1, below which both pictures are as good: a tenth of that of
rounding to 8 bits."""


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
        InputError: Views, slopes or weights that cannot be used.

    Example:
        >>> lfref.super_resolve(torch.rand(5, 5, 3, 48, 64), [0.3], factor=2).shape
        torch.Size([1, 3, 96, 128])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    planes, aperture = geometry.checked_slopes(slopes, grid, size), batches.checked_weights(weights, grid)
    batch = batches.without_unread(batch, aperture)
    if batch.is_floating_point():
        batch = batch.to(batches.working_dtype(batch.dtype))  # half types are rounded once, at the end
    # Both pictures predict the views in grey, the brightest pixel 1.
    grey = torch.stack([batches.radiance(row).mean(2) for row in batch.unbind(1)], 1)
    brightest = grey.detach().abs().amax((1, 2, 3, 4)).clamp(min=torch.finfo(grey.dtype).tiny)[:, None, None]
    grey = grey / brightest[..., None, None]
    stack = band_limited(exact_fourier(batch, planes, aperture), factor)
    blends = []
    for slope, plane in zip(planes.tolist(), stack.unbind(1), strict=True):
        fine = in_focus(batch, slope, factor, aperture)
        of_fine, of_plane = (_errors(grey, each.mean(1) / brightest, slope, aperture, factor) for each in (fine, plane))
        share = ((UNSURE - of_fine / of_plane) / (UNSURE - SURE)).clamp(0, 1)
        blends.append(torch.lerp(plane, fine, F.interpolate(share, scale_factor=factor, mode="bilinear")))
    return batches.restored(torch.stack(blends, 1), views)


def in_focus(views: Tensor, slope: float, factor: int, aperture: Tensor) -> Tensor:
    """The fine picture [B, C, r H, r W] of views [B, V, U, C, H, W] weighed by an aperture of sum 1: linear in them."""
    down, across = (
        _phases(length, factor, n, slope) for length, n in zip(views.shape[-2:], aperture.shape, strict=True)
    )
    sums = torch.zeros((), dtype=fourier.complex_dtype(views.dtype), device=views.device)  # E, [B, C, r, H, r, W]
    for row, row_phases, weights in zip(views.unbind(1), down, aperture, strict=True):
        spectra = torch.fft.fft2(batches.radiance(row))
        total = torch.einsum("buchw,urw->bchrw", spectra, (across * weights[:, None, None]).to(spectra))
        sums = sums + total[:, :, None] * row_phases.to(spectra)[:, :, None, None]
    return _picture(_solved(sums, slope, factor, aperture))


def _solved(sums: Tensor, slope: float, factor: int, aperture: Tensor) -> Tensor:
    """The spectrum F^ = r^2 (D* G D + P)^-1 D* E of the fine picture; E and F^ [B, C, r, H, r, W]."""
    size = sums.shape[3], sums.shape[5]
    q_rows, q_columns = (_frequencies(length, factor).T for length in size)  # [H, r] and [W, r]
    mean_rows, mean_columns = (_mean(length, factor).T for length in size)
    # G of two q, sum_i w_i exp(2 pi i s i (q - q')), is a table by their distance, which is whole along both axes.
    lags = torch.arange(1 - factor, factor, dtype=torch.float64)
    down, across = (_waves(slope * lags[:, None] * geometry.angular_offsets(n)) for n in aperture.shape)
    gram_of_lags = down @ aperture.to(down) @ across.T
    lag_rows, lag_columns = (
        (q[:, :, None] - q[:, None]).round().long() + factor - 1 for q in (q_rows, q_columns)
    )  # [H, r, r] and [W, r, r]
    spectra = []
    # The matrices [K, W, r r, r r] of some rows of k at a time: 64 MB.
    for part in torch.arange(size[0]).split(max(1, (1 << 22) // (factor**4 * size[1]))):
        mean = (mean_rows[part, None, :, None] * mean_columns[:, None]).flatten(2)
        gram = gram_of_lags[lag_rows[part, None, :, None, :, None], lag_columns[:, None, :, None, :]]
        squares = (q_rows[part, None, :, None].square() + q_columns[:, None].square()).flatten(2) + OUTER**2
        penalty = RIDGE * ((squares / squares.amin(2, keepdim=True)).pow(DECAY / 2) - 1)
        # Where several q are the lowest, no view may tell them apart: they share.
        is_lowest = squares < (1 + 1e-9) * squares.amin(2, keepdim=True)
        penalty = penalty + TIED * (is_lowest & (is_lowest.sum(2, keepdim=True) > 1))
        matrix = mean.conj()[..., None] * gram.flatten(4).flatten(2, 3) * mean[..., None, :] + torch.diag_embed(penalty)
        solution = factor**2 * torch.linalg.solve(matrix, torch.diag_embed(mean.conj()))
        folded = sums[:, :, :, part].permute(3, 5, 2, 4, 0, 1)  # K W r r B C
        solved = solution.to(sums) @ folded.flatten(4).flatten(2, 3)
        spectra.append(solved.reshape(folded.shape).permute(4, 5, 2, 0, 3, 1))
    return torch.cat(spectra, 3)


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


def _errors(views: Tensor, picture: Tensor, slope: float, aperture: Tensor, factor: int) -> Tensor:
    """Mean squared error [B, 1, H, W] around each pixel of a picture that predicts grey views [B, V, U, H, W]."""
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
