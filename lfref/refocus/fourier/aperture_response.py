"""What an aperture makes of a layer out of focus: the transform of its weights, and of the area of one view's cell.

A layer of disparity d, seen through weights `w_uv` and focused at s, is multiplied at each frequency by
`D(e) = sum_uv w_uv exp(2 pi i e ((u - u0) kx + (v - v0) ky))`, e = s - d, and, where each view stands for a cell `fill`
view steps wide, by `c(e) = sinc(fill e kx) sinc(fill e ky)`. For U x V equal weights and fill 1 both together are the
transform of the whole square, `sinc(U e kx) sinc(V e ky)`.
Letters: `u v` view column and row, `kx ky` frequency in cycles per pixel, `h w` numbers of rows and columns of them.
"""

import math

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier

NEGLIGIBLE = 1e-12  # share of the largest singular value below which there is only rounding


def of_points(distances: Tensor, aperture: Tensor, rows: Tensor, columns: Tensor, dtype: torch.dtype) -> Tensor:
    """The transform D of the weights: real where opposite views weigh the same, as in most apertures.

    Args:
        distances: From the layer to the plane in focus, s - d, in pixels per view step, [...].
        aperture: Weight of each view, float64, [V, U].
        rows: ky in cycles per pixel, float64, [h].
        columns: kx in cycles per pixel, float64, [w].
        dtype: float32 or float64; phases are made in float64 all the same.

    Returns:
        In `dtype`, or the complex type that goes with it, [..., h, w].
    """
    left, strength, right = torch.linalg.svd(aperture, full_matrices=False)
    rank = int((strength > NEGLIGIBLE * strength[0]).sum())  # 1 for products of rows and columns
    down = _sums(distances, rows, left[:, :rank] * strength[:rank]).to(fourier.complex_dtype(dtype))
    across = _sums(distances, columns, right[:rank].T).to(down)
    real = torch.cat([down.real, -down.imag], -2).mT @ torch.cat([across.real, across.imag], -2)
    if torch.allclose(aperture, aperture.flip(0, 1), rtol=NEGLIGIBLE, atol=0):
        return real
    return torch.complex(real, torch.cat([down.real, down.imag], -2).mT @ torch.cat([across.imag, across.real], -2))


def of_cell(distances: Tensor, fill: float, rows: Tensor, columns: Tensor, dtype: torch.dtype) -> Tensor:
    """The transform c of one view's cell; arguments as for `of_points`.

    Args:
        distances: As in `of_points`.
        fill: Width of the cells in view steps, >= 0.
        rows: As in `of_points`.
        columns: As in `of_points`.
        dtype: As in `of_points`.

    Returns:
        In `dtype`, [..., h, w].
    """
    down, across = (torch.sinc(fill * distances[..., None] * k).to(dtype) for k in (rows, columns))
    return down[..., :, None] * across[..., None, :]


def checked_fill(fill: float) -> float:
    """The width of a view's cell in view steps, once it is known to be finite and at least 0."""
    if not (math.isfinite(fill) and fill >= 0):
        raise InputError("fill must be finite and at least 0, in view steps", got=fill)
    return float(fill)


def _sums(distances: Tensor, frequencies: Tensor, weights: Tensor) -> Tensor:
    """Sums over the views of one axis, for each term of the weights [views, r], complex128, [..., r, K]."""
    angle = 2 * torch.pi * distances[..., None, None] * geometry.angular_offsets(len(weights))[:, None] * frequencies
    return weights.T.to(torch.complex128) @ torch.polar(torch.ones_like(angle), angle)
