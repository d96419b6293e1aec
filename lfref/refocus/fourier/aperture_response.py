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
from lfref.refocus.fourier.mixing import Matrices

NEGLIGIBLE = 1e-12  # below this there is only rounding


def of_points(distances: Tensor, aperture: Tensor, size: tuple[int, int]) -> Matrices:
    """The transform D of the weights: real where opposite views weigh the same, as in most apertures.

    Args:
        distances: From each layer to each plane in focus, s - d, in pixels per view step, float64, [N, K].
        aperture: Weight of each view, float64, [V, U].
        size: Height and width (H, W) of the pictures in pixels.

    Returns:
        [N, K] at the frequencies of `rfft2`.
    """
    left, strength, right = torch.linalg.svd(aperture, full_matrices=False)
    rank = int((strength > NEGLIGIBLE * strength[0]).sum())  # 1 for products of rows and columns
    down = _sums(distances, fourier.frequencies(size[0]), left[:, :rank] * strength[:rank])
    across = _sums(distances, fourier.half_frequencies(size[1]), right[:rank].T)
    if not torch.allclose(aperture, aperture.flip(0, 1), rtol=NEGLIGIBLE, atol=0):
        return Matrices(down, across)
    rows, columns = torch.cat([down.real, -down.imag], -2), torch.cat([across.real, across.imag], -2)
    # Apertures whose rows and columns are symmetric themselves have no imaginary parts.
    counts = (rows.abs().amax((0, 1, 3)) > NEGLIGIBLE) & (columns.abs().amax((0, 1, 3)) > NEGLIGIBLE)
    return Matrices(rows[..., counts, :], columns[..., counts, :])


def of_cell(distances: Tensor, fill: float, size: tuple[int, int]) -> Matrices:
    """The transform c of one view's cell.

    Args:
        distances: As in `of_points`.
        fill: Width of the cells in view steps, >= 0.
        size: As in `of_points`.

    Returns:
        [N, K] at the frequencies of `rfft2`.
    """
    frequencies = fourier.frequencies(size[0]), fourier.half_frequencies(size[1])
    return Matrices(*(torch.sinc(fill * distances[..., None, None] * k) for k in frequencies))


def checked_fill(fill: float) -> float:
    """The width of a view's cell in view steps, once it is known to be finite and at least 0."""
    if not (math.isfinite(fill) and fill >= 0):
        raise InputError("fill must be finite and at least 0, in view steps", got=fill)
    return float(fill)


def _sums(distances: Tensor, frequencies: Tensor, weights: Tensor) -> Tensor:
    """Sums over the views of one axis, for each term of the weights [views, r], complex128, [N, K, r, frequencies]."""
    turns = distances[..., None] * geometry.angular_offsets(len(weights))
    angle = 2 * torch.pi * turns[..., None] * frequencies
    return weights.T.to(torch.complex128) @ torch.polar(torch.ones_like(angle), angle)
