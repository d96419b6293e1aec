"""Fourier-slice refocusing: a photograph's spectrum is a 2-D slice of the light field's 4-D spectrum.

`I^(k) = L^(k, angular bin -s k M / N)`. The angular bins fall between samples, where a kernel reads them; padding the
aperture with black views (M bins for U views) makes the bins finer. The angular transform and the kernel's reading
are both sums, over views and over bins, and their order is free: carried out over the bins first, they leave one
factor for each view and frequency, so that the padded 4-D spectrum (some 500 MB in the paper's case) never exists.
Reading a spectrum with kernel c multiplies the views by the transform of c, so the views are divided by it first;
leaving that out makes the picture turn brighter with the slope. Every pixel of the result depends on every pixel of the
views. Methods: `fourier_slice_linear` is Ng's own, linear and without padding, `fourier_slice` the gridded one.
Letters: `u v` view column and row, `k` frequency in cycles per pixel, `m` angular bin, `M` padded angular size, `t`
distance in bins, `W` kernel width in bins, `sigma` oversampling M / N (padded over original size).
Sources: Ng, "Fourier Slice Photography", 2005; Beatty, Nishimura, Pauly, "Rapid gridding reconstruction with a minimal
oversampling ratio", 2005, eq. 5 (beta).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError, chosen
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.fourier import exact


class Kernel(NamedTuple):
    """A kernel and its transform."""

    width: int
    """Bins that it spans."""
    weight: Callable[[Tensor], Tensor]
    """Value at a distance in bins."""
    transform: Callable[[Tensor], Tensor]
    """What the views are divided by, at a position as a share of the padded aperture, in [-1/2, 1/2]."""


def linear(width: int, sigma: float) -> Kernel:
    """Linear interpolation between the two nearest bins, as in Ng 2005, whatever the arguments; divides by nothing."""
    return Kernel(2, lambda t: (1 - t.abs()).clamp(min=0), torch.ones_like)


def kaiser_bessel(width: int, sigma: float) -> Kernel:
    """The Kaiser-Bessel kernel with Beatty's beta; width >= 2 bins, oversampling sigma >= 1."""
    if width < 2 or sigma < 1:
        raise InputError("a Kaiser-Bessel kernel needs width >= 2 and padding >= 1", got=f"{width} and {sigma:g}")
    beta = math.pi * math.sqrt((width / sigma) ** 2 * (sigma - 0.5) ** 2 - 0.8)

    def weight(t: Tensor) -> Tensor:
        inside = (1 - (2 * t / width) ** 2).clamp(min=0)
        # At the jump at its ends the kernel counts half, on both sides alike.
        share = torch.heaviside(width / 2 - t.abs(), torch.tensor(0.5, dtype=t.dtype))
        return share * torch.special.i0(beta * inside.sqrt()) / width

    def transform(position: Tensor) -> Tensor:
        root = torch.complex(beta**2 - (math.pi * width * position) ** 2, torch.zeros_like(position)).sqrt()
        return torch.where(root.abs() < 1e-8, torch.ones_like(position), (root.sinh() / root).real)

    return Kernel(width, weight, transform)


KERNELS: dict[str, Callable[[int, float], Kernel]] = {"linear": linear, "kaiser_bessel": kaiser_bessel}


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
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        slopes: Focus in pixels per view step, [N].
        kernel: `kaiser_bessel` or `linear`.
        width: Angular bins that the kernel spans (`linear` always spans 2).
        padding: Padded over original number of views along each angular axis, >= 1.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the slopes, type (float32 for integers) and device of the views, [..., N, C, H, W].

    Raises:
        InputError: Views, slopes, weights, kernel or padding that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> stack = lfref.fourier_slice(views, [0, 0.25], width=6)
        >>> torch.allclose(stack, lfref.exact_fourier(views, [0, 0.25]), atol=1e-4)
        True
    """
    if not (math.isfinite(padding) and padding >= 1):
        raise InputError("padding must be finite and at least 1", got=padding)
    batch, kernel_of = batches.flattened(views), chosen("kernel", kernel, KERNELS)
    grid, size = batches.grid_and_size(batch)
    planes = geometry.checked_slopes(slopes, grid, size)
    padded = [math.ceil(padding * n_views) for n_views in grid]
    readers = [kernel_of(width, m / n_views) for n_views, m in zip(grid, padded, strict=True)]
    axes = zip(grid, padded, readers, (fourier.frequencies(size[0]), fourier.half_frequencies(size[1])), strict=True)
    rows, columns = (
        fourier.real_at_nyquist(_read(planes[:, None] * k, n_views, m, reader), k) for n_views, m, reader, k in axes
    )
    rows, columns = (factors.to(views.device) for factors in (rows, columns))
    aperture = batches.checked_weights(weights, grid)
    stack = exact.filter_and_sum(batches.without_unread(batch, aperture), rows, columns, aperture)
    return batches.restored(stack, views)


def _read(crossing: Tensor, n_views: int, padded: int, kernel: Kernel) -> Tensor:
    """Share of each of U views in what a slice reads among M padded bins of one angular axis, complex128, [N, U, K].

    The slice crosses the axis at minus `crossing` = s k, [N, K], in cycles per view; the factors are near
    exp(2 pi i s k (u - u0)).
    """
    offsets = geometry.angular_offsets(n_views)
    position = -crossing[..., None] * padded
    bins = torch.ceil(position - kernel.width / 2) + torch.arange(kernel.width + 1, dtype=torch.float64)
    taps = kernel.weight(position - bins)
    angle = -2 * torch.pi * bins[:, None] * offsets[:, None, None] / padded
    read = torch.polar(taps[:, None].expand_as(angle), angle).sum(-1) / kernel.transform(offsets / padded)[:, None]
    # Where the slice crosses bin 0 itself there is nothing to interpolate: every plane is as bright as the views.
    return torch.where(crossing[:, None] == 0, 1.0, read)
