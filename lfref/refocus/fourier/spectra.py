"""Refocusing in the Fourier domain: every view's 2-D spectrum times a factor for its row and one for its column.

`I^(k) = sum_v R[v](ky) sum_u C[u](kx) L^[v, u](k)`. What the factors are is the operator's: exact phase ramps, or what
a slice of the 4-D spectrum reads. Their being separable makes it a pass over the views of a row, then one over rows.
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel.
"""

import torch
from torch import Tensor

from lfref.functional import fourier
from lfref.refocus import batches


def filter_and_sum(views: Tensor, rows: Tensor, columns: Tensor, weights: Tensor) -> Tensor:
    """Sum of the filtered views, for every plane.

    Args:
        views: Light fields, [B, V, U, C, H, W], taken as periodic.
        rows: Factors of the view rows at the frequencies of `fft`, complex, [N, V, H].
        columns: Factors of the view columns at the frequencies of `rfft`, complex, [N, U, W // 2 + 1], or of the views
            of each row, [N, V or 1, U, W // 2 + 1].
        weights: Factor of each view, [V, U].

    Returns:
        Stacks, float32 or float64, [B, N, C, H, W].
    """
    size, working = (views.shape[-2], views.shape[-1]), batches.working_dtype(views.dtype)
    dtype = fourier.complex_dtype(working)
    rows, columns = rows.to(views.device, dtype), columns.to(views.device, dtype)
    columns = columns.unsqueeze(1) if columns.ndim == 3 else columns
    views, weights = batches.without_unread(views, weights), weights.to(views.device, working)
    shape = (views.shape[0], *views.shape[3:5], size[1] // 2 + 1)
    planes = [rows.new_zeros(shape) for _ in rows]
    for v, (view_row, row_weights) in enumerate(zip(views.unbind(1), weights, strict=True)):
        # One view row at a time: its spectra are all that is held beside the planes.
        spectra = torch.fft.rfft2(batches.radiance(view_row))
        of_row = columns[:, v if columns.shape[1] > 1 else 0] * row_weights[:, None]
        for plane, row_factors, column_factors in zip(planes, rows[:, v], of_row, strict=True):
            plane.addcmul_(_row_sum(spectra, column_factors), row_factors[:, None])
    # Each spectrum is given up as its image is made: all of both together would be the peak of memory.
    stack = views.new_empty((views.shape[0], len(planes), views.shape[3], *size), dtype=working)
    for n in reversed(range(len(planes))):
        stack[:, n] = torch.fft.irfft2(planes.pop(), s=size)
    return stack


def _row_sum(spectra: Tensor, factors: Tensor) -> Tensor:
    """Views of one row, [B, U, C, H, K], times their factors, [U, K], added up."""
    total = spectra[:, 0] * factors[0]
    for spectrum, factor in zip(spectra.unbind(1)[1:], factors[1:], strict=True):
        total.addcmul_(spectrum, factor)
    return total
