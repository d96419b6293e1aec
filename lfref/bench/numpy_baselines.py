"""Refocusing in plain NumPy, as one would write it without this package: what the operators' speed is compared with.

Letters: `u v` view column and row, `k` frequency in cycles per pixel, `M` padded angular size, `W` kernel width.
Sources: Ng, "Fourier Slice Photography", 2005; Beatty et al., 2005, for the kernel (`lfref.refocus.fourier.slice`).
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[Any]


def fourier_slice_numpy(views: Tensor, slopes: Tensor | Sequence[float], width: int = 4, padding: float = 2) -> Tensor:
    """Fourier-slice refocusing by `numpy.fft.fftn`, one channel after the other as the paper does.

    The same spectrum as `lfref.refocus.fourier.slice.fourier_slice` with the Kaiser-Bessel kernel, to some 1e-5; at
    frequency 0, which is interpolated here as all others, to some 1e-3. Where a size is even, its highest frequency
    differs.

    Args:
        views: Radiance, float32 or float64, CPU, [V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        width: Angular bins that the kernel spans.
        padding: Padded over original number of views along each angular axis, >= 1.

    Returns:
        Stack, type of the views, [N, C, H, W].
    """
    planes = torch.as_tensor(slopes, dtype=torch.float64).tolist()
    channels = [_channel(channel, planes, width, padding) for channel in views.numpy().transpose(2, 0, 1, 3, 4)]
    return torch.from_numpy(np.stack(channels, axis=1)).to(views.dtype)


class _Axis(NamedTuple):
    """One angular axis and its kernel."""

    n_views: int
    padded: int
    width: int
    beta: float

    def correction(self) -> Array:
        """What the views are divided by: the transform of the kernel, [n_views]."""
        position = (np.arange(self.n_views) - (self.n_views - 1) / 2) / self.padded
        root = np.sqrt(self.beta**2 - (np.pi * self.width * position) ** 2 + 0j)
        return np.where(root == 0, 1, np.sinh(root) / np.where(root == 0, 1, root)).real

    def taps(self, slope: float, frequencies: Array) -> tuple[Array, Array]:
        """Bins that the slice reads at each frequency and their factors, both [width, K]."""
        position = -slope * frequencies * self.padded
        # A bin at either end of the kernel is read at one end only: the real part of the image is their mean.
        bins = np.floor(position - self.width / 2).astype(int) + np.arange(1, self.width + 1)[:, None]
        distance = 2 * (position - bins) / self.width
        weights = np.i0(self.beta * np.sqrt(np.maximum(1 - distance**2, 0))) / self.width
        centre = (self.n_views - 1) / 2
        return bins % self.padded, weights * np.exp(2j * np.pi * bins * centre / self.padded)


def _channel(views: Array, slopes: Sequence[float], width: int, padding: float) -> Array:
    """Stack of one channel, [N, H, W], of its views, [V, U, H, W]."""
    n_rows, n_columns, *size = views.shape
    rows, columns = _axis(n_rows, width, padding), _axis(n_columns, width, padding)
    correction = np.multiply.outer(rows.correction(), columns.correction()) * n_rows * n_columns
    corrected = views / correction[:, :, None, None].astype(views.dtype)
    spectrum = np.fft.fftn(corrected, s=(rows.padded, columns.padded, *size), axes=(0, 1, 2, 3))
    ky, kx = (np.fft.fftfreq(length) for length in size)
    planes = [_slice(spectrum, rows.taps(slope, ky), columns.taps(slope, kx)) for slope in slopes]
    return np.stack([np.fft.ifft2(plane).real for plane in planes])


def _axis(n_views: int, width: int, padding: float) -> _Axis:
    padded = math.ceil(padding * n_views)
    sigma = padded / n_views
    return _Axis(n_views, padded, width, math.pi * math.sqrt((width / sigma) ** 2 * (sigma - 0.5) ** 2 - 0.8))


def _slice(spectrum: Array, rows: tuple[Array, Array], columns: tuple[Array, Array]) -> Array:
    """The 2-D slice of a 4-D spectrum [M, M, H, W], its taps read by index and added up, [H, W]."""
    y, x = np.ogrid[: spectrum.shape[2], : spectrum.shape[3]]
    total = np.zeros(spectrum.shape[2:], spectrum.dtype)
    for row_bins, row_factors in zip(*rows, strict=True):
        row_sum = np.zeros_like(total)
        for column_bins, column_factors in zip(*columns, strict=True):
            row_sum += spectrum[row_bins[:, None], column_bins, y, x] * column_factors.astype(total.dtype)
        total += row_sum * row_factors[:, None].astype(total.dtype)
    return total
