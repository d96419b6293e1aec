"""Fourier-slice refocusing: one 4-D transform, then a 2-D slice of it for each plane.

`I^(k) = L^(k, angular bin -s k M / N)`: a photograph's spectrum is a slice of the light field's. The angular bins
fall between samples, where a kernel reads them; padding the aperture with black views (M bins for U views) makes
the bins finer. Global by nature: every pixel of the result depends on every pixel of the views.
Letters: `u v` view column and row, `k` frequency in cycles per pixel, `m` angular bin, `M` padded angular size.
Source: Ng, "Fourier Slice Photography", 2005.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError, chosen
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.kernels import KERNELS, Kernel


def fourier_slice(
    views: Tensor,
    slopes: Slopes,
    kernel: str = "kaiser_bessel",
    width: int = 4,
    padding: float = 2,
    weights: Tensor | None = None,
) -> Tensor:
    """Refocus light fields by slicing their 4-D spectrum, the views taken as periodic.

    Args:
        views: Radiance, usually in [0, 1], floating point, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        kernel: `kaiser_bessel` or `linear`.
        width: Angular bins that the kernel spans (`linear` always spans 2).
        padding: Padded over original number of views along each angular axis, >= 1.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes, weights, kernel or padding that cannot be used.
    """
    if not (math.isfinite(padding) and padding >= 1):
        raise InputError("padding must be finite and at least 1", got=padding)
    return batches.over_batches(views, lambda batch: _stack(batch, slopes, kernel, width, padding, weights))


class _Taps(NamedTuple):
    """Where the slice crosses the angular bins of one axis."""

    bins: Tensor
    """Angular bins around each frequency's crossing, [K, taps]."""
    weights: Tensor
    """Complex weights of these bins, [K, taps]."""


def _stack(views: Tensor, slopes: Slopes, kernel: str, width: int, padding: float, weights: Tensor | None) -> Tensor:
    grid, size = (views.shape[1], views.shape[2]), (views.shape[-2], views.shape[-1])
    planes = geometry.checked_slopes(slopes, grid, size).tolist()
    padded = [math.ceil(padding * n_views) for n_views in grid]
    make = chosen("kernel", kernel, KERNELS)
    readers = [make(width, m / n) for n, m in zip(grid, padded, strict=True)]
    aperture = batches.checked_weights(weights, grid) / _gain(grid, padded, readers)
    spectrum = torch.fft.rfftn(views * aperture.to(views)[:, :, None, None, None], (*padded, *size), (1, 2, -2, -1))
    spectrum = _split_nyquist(spectrum, size)
    rows_at, columns_at = _split_frequencies(size)
    images = []
    for slope in planes:
        rows = _taps(slope * rows_at, grid[0], padded[0], readers[0])
        columns = _taps(slope * columns_at, grid[1], padded[1], readers[1])
        images.append(torch.fft.irfft2(_merge_nyquist(_slice(spectrum, rows, columns), size), s=size))
    return torch.stack(images, dim=1)


def _gain(grid: Sequence[int], padded: Sequence[int], readers: Sequence[Kernel]) -> Tensor:
    """What reading with the kernels multiplies each view by, [V, U]."""
    rows, columns = (
        reader.transform(geometry.angular_offsets(n_views) / m)
        for n_views, m, reader in zip(grid, padded, readers, strict=True)
    )
    return rows[:, None] * columns


def _taps(crossing: Tensor, n_views: int, padded: int, kernel: Kernel) -> _Taps:
    """Bins and weights that read the angular spectrum where the slice crosses it.

    Args:
        crossing: s k, minus the angular frequency in cycles per view, [K].
        n_views: Views along the axis.
        padded: Angular bins along the axis, M.
        kernel: Reads between bins.
    """
    position = -crossing[:, None] * padded
    bins = torch.ceil(position - kernel.width / 2) + torch.arange(kernel.width + 1, dtype=torch.float64)
    # The transform counts views from 0, the slice from the aperture's centre u0.
    angle = 2 * torch.pi * bins * (n_views - 1) / 2 / padded
    return _Taps((bins % padded).long(), torch.polar(kernel.weight(position - bins), angle))


def _slice(spectrum: Tensor, rows: _Taps, columns: _Taps) -> Tensor:
    """Read a slice [B, C, H, W] out of the spectrum [B, M, M, C, H, W]; horizontal angular axis first."""
    horizontal = _read(spectrum.movedim(2, -1), columns)
    return _read(horizontal.permute(0, 2, 4, 3, 1), rows).transpose(-1, -2)


def _read(spectrum: Tensor, taps: _Taps) -> Tensor:
    """Weighted sum over the taps: [..., K, M] -> [..., K]."""
    total = torch.zeros_like(spectrum[..., 0])
    weights = taps.weights.to(spectrum)
    for bins, weight in zip(taps.bins.to(spectrum.device).unbind(1), weights.unbind(1), strict=True):
        index = bins.expand(total.shape)[..., None]
        total = total + weight * torch.gather(spectrum, -1, index)[..., 0]
    return total


def _split_frequencies(size: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Vertical and horizontal frequencies, the Nyquist bin of an even size with both signs (see `_split_nyquist`)."""
    rows, columns = fourier.frequencies(size[0]), fourier.half_frequencies(size[1])
    one = torch.full((1,), 0.5, dtype=torch.float64)
    return (
        torch.cat([rows, one]) if size[0] % 2 == 0 else rows,
        torch.cat([columns, -one]) if size[1] % 2 == 0 else columns,
    )


def _split_nyquist(spectrum: Tensor, size: Sequence[int]) -> Tensor:
    """Append a copy of the Nyquist row and column of even sizes: it belongs to both signs of its frequency."""
    if size[0] % 2 == 0:
        spectrum = torch.cat([spectrum, spectrum[..., size[0] // 2, :][..., None, :]], dim=-2)
    if size[1] % 2 == 0:
        spectrum = torch.cat([spectrum, spectrum[..., -1:]], dim=-1)
    return spectrum


def _merge_nyquist(image: Tensor, size: Sequence[int]) -> Tensor:
    """Undo `_split_nyquist` by the mean of the two copies."""
    height, half = size[0], size[1] // 2
    if height % 2 == 0:
        nyquist = (image[..., height // 2, :] + image[..., height, :]) / 2
        upper, lower = image[..., : height // 2, :], image[..., height // 2 + 1 : height, :]
        image = torch.cat([upper, nyquist[..., None, :], lower], dim=-2)
    if size[1] % 2 == 0:
        nyquist = (image[..., half] + image[..., half + 1]) / 2
        image = torch.cat([image[..., :half], nyquist[..., None]], dim=-1)
    return image
