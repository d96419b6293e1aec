"""Fourier-slice refocusing in plain NumPy, as one would write it without lfref: a baseline for time only.

Letters: `u v` view column and row, `k` frequency in cycles per pixel, `M` padded angular size, `W` kernel width.
Sources: Ng, "Fourier Slice Photography", 2005; Beatty et al., 2005, for the kernel (`lfref.refocus.fourier.slice`).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[Any]


def fourier_slice_numpy(views: Tensor, slopes: Tensor | Sequence[float], width: int = 4, padding: float = 2) -> Tensor:
    """Fourier-slice refocusing by `numpy.fft.fftn`, one channel after the other as the paper does.

    Its spectrum is that of `lfref.refocus.fourier.slice.fourier_slice` with the Kaiser-Bessel kernel to about 1e-5,
    except at frequency 0 (1e-3) and at the highest frequency of even sizes.

    Args:
        views: Radiance, float32 or float64, CPU, [V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        width: Number of angular bins that the kernel spans.
        padding: Ratio of the padded number of views to the original one, along each angular axis, >= 1.

    Returns:
        Stack, type of the views, [N, C, H, W].
    """
    planes = torch.as_tensor(slopes, dtype=torch.float64).tolist()
    channels = [_channel_stack(channel, planes, width, padding) for channel in views.numpy().transpose(2, 0, 1, 3, 4)]
    return torch.from_numpy(np.stack(channels, axis=1)).to(views.dtype)


def _channel_stack(views: Array, slopes: Sequence[float], width: int, padding: float) -> Array:
    """Stack [N, H, W] of one channel's views [V, U, H, W]."""
    n_rows, n_columns, *size = views.shape
    padded = [math.ceil(padding * n) for n in (n_rows, n_columns)]
    betas = [_beta(width, M / n) for M, n in zip(padded, (n_rows, n_columns), strict=True)]
    # The views are divided by the transform of the kernel, else the picture gets darker towards the outer views.
    rows, columns = (
        _kernel_transform(n, M, width, beta) for n, M, beta in zip((n_rows, n_columns), padded, betas, strict=True)
    )
    corrected = views / (np.multiply.outer(rows, columns) * n_rows * n_columns)[:, :, None, None].astype(views.dtype)
    spectrum = np.fft.fftn(corrected, s=(*padded, *size), axes=(0, 1, 2, 3))
    ky, kx = (np.fft.fftfreq(length) for length in size)
    planes = []
    for slope in slopes:
        row_taps = _taps(slope * ky, n_rows, padded[0], width, betas[0])
        column_taps = _taps(slope * kx, n_columns, padded[1], width, betas[1])
        planes.append(np.fft.ifft2(_slice(spectrum, row_taps, column_taps)).real)
    return np.stack(planes)


def _beta(width: int, sigma: float) -> float:
    return math.pi * math.sqrt((width / sigma) ** 2 * (sigma - 0.5) ** 2 - 0.8)


def _kernel_transform(n_views: int, padded: int, width: int, beta: float) -> Array:
    position = (np.arange(n_views) - (n_views - 1) / 2) / padded
    root = np.sqrt(beta**2 - (np.pi * width * position) ** 2 + 0j)
    return np.where(root == 0, 1, np.sinh(root) / np.where(root == 0, 1, root)).real


def _taps(crossing: Array, n_views: int, padded: int, width: int, beta: float) -> tuple[Array, Array]:
    """Angular bins that the slice reads at each frequency, and their factors, both [width, K]."""
    position = -crossing * padded
    # A bin at either end of the kernel is read at one end only: the real part of the image is their mean.
    bins = np.floor(position - width / 2).astype(int) + np.arange(1, width + 1)[:, None]
    distance = 2 * (position - bins) / width
    weights = np.i0(beta * np.sqrt(np.maximum(1 - distance**2, 0))) / width
    return bins % padded, weights * np.exp(1j * np.pi * bins * (n_views - 1) / padded)


def _slice(spectrum: Array, rows: tuple[Array, Array], columns: tuple[Array, Array]) -> Array:
    """The 2-D slice [H, W] of a 4-D spectrum [M, M, H, W]: taps read by index and added up."""
    y, x = np.ogrid[: spectrum.shape[2], : spectrum.shape[3]]
    total = np.zeros(spectrum.shape[2:], spectrum.dtype)
    for row_bins, row_factors in zip(*rows, strict=True):
        row_sum = np.zeros_like(total)
        for column_bins, column_factors in zip(*columns, strict=True):
            row_sum += spectrum[row_bins[:, None], column_bins, y, x] * column_factors.astype(total.dtype)
        total += row_sum * row_factors[:, None].astype(total.dtype)
    return total
