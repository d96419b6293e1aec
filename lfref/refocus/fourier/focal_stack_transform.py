"""The discrete focal stack transform: all planes of an even grid of slopes at once.

On such a grid the phase of view u in plane j is a product j u at every frequency: a fractional Fourier transform.
As `j u = (j^2 + u^2 - (j - u)^2) / 2`, it is a convolution with a chirp (Bluestein), so that a row of U views becomes
N planes in the time of two FFTs of length U + N - 1, in place of U N steps.
Letters: `u v` view column and row, `j` plane, each counted from its middle, `kx ky` frequency in cycles per pixel.
Source: Nava, Marichal-Hernandez, Rodriguez-Ramos, "The Discrete Focal Stack Transform", 2008.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier
from lfref.geometry import Slopes
from lfref.refocus import batches


def focal_stack_transform(
    views: Tensor,
    n_planes: int,
    first: float = -1.0,
    last: float = 1.0,
    weights: Tensor | None = None,
) -> Tensor:
    """Refocus light fields at evenly spaced slopes, the views taken as periodic.

    Equals `exact_fourier` at `geometry.even_slopes`, and is faster only for many views and planes: never with 7x7
    views, with 13x13 from some 50 planes, with 17x17 from some 12.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        n_planes: Number of planes, >= 1; a single one lies midway.
        first: Slope of the first plane, in pixels per view step.
        last: Slope of the last plane, in pixels per view step.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks from the first slope to the last, type (float32 for integers) and device of the views,
        [..., n_planes, C, H, W].

    Raises:
        InputError: Views, slopes or weights that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> stack = lfref.focal_stack_transform(views, 9, first=-2, last=2)
        >>> torch.allclose(stack, lfref.exact_fourier(views, lfref.even_planes(9, -2, 2).slopes), atol=1e-5)
        True
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    slopes = geometry.checked_slopes(geometry.even_slopes(n_planes, first, last), grid, size)
    aperture = batches.checked_weights(weights, grid)
    device, dtype = views.device, fourier.complex_dtype(views.dtype)
    ky, kx = fourier.frequencies(size[0]), fourier.half_frequencies(size[1])
    rows = torch.complex(*fourier.shift_phases(ky, slopes[:, None] * geometry.angular_offsets(grid[0])))
    before, between, after = _chirps(slopes, grid[1], kx)
    rows, before, between, after = (factors.to(device, dtype) for factors in (rows, before, between, after))
    # Spectra of the planes in bands of rows, [B, N, C, h, W // 2 + 1]: the padded sums stay small beside the stack.
    height = 8
    factors = rows[..., None].split(height, dim=-2)
    shape = (len(batch), len(slopes), batch.shape[3])
    bands = [rows.new_zeros(*shape, part.shape[-2], len(kx)) for part in factors]
    for v, view_row in enumerate(batches.without_unread(batch, aperture).unbind(1)):
        # One view row at a time: its spectra are all that is held beside the planes.
        spectra = torch.fft.rfft2(batches.radiance(view_row))
        weighted = before * aperture[v].to(rows)[:, None, None, None]
        for band, part, factor in zip(bands, spectra.split(height, dim=-2), factors, strict=True):
            padded = torch.fft.fft(part * weighted, n=len(between), dim=1)
            band.addcmul_(torch.fft.ifft(padded * between, dim=1)[:, : len(slopes)], factor[:, v, None])
    stack = torch.cat([band.mul_(after) for band in bands], dim=-2)
    # The columns were shifted by one sign of the Nyquist bin. With the rows transformed back, that bin holds a real
    # signal times its factor, so the mean of both signs is the real part, which not every inverse transform takes.
    planes = [
        torch.fft.irfft(
            torch.complex(*fourier.real_at_nyquist(torch.fft.ifft(plane, dim=-2), kx.to(device))), n=size[1]
        )
        for plane in stack.unbind(1)
    ]
    return batches.restored(torch.stack(planes, dim=1), views)


def at_slopes(views: Tensor, slopes: Slopes, weights: Tensor | None = None) -> Tensor:
    """`focal_stack_transform` at slopes [N]; an InputError unless they are evenly spaced."""
    values = torch.as_tensor(slopes, dtype=torch.float64, device="cpu").reshape(-1)
    if len(values) == 0:
        raise InputError("slopes must be at least one", got="an empty list")
    first, last = float(values[0]), float(values[-1])
    if not torch.allclose(values, torch.linspace(first, last, len(values), dtype=torch.float64), rtol=0, atol=1e-6):
        raise InputError(
            "the focal stack transform makes evenly spaced planes only",
            got=f"slopes {[round(slope, 4) for slope in values.tolist()]}",
            remedy="take evenly spaced slopes, or another method",
        )
    return focal_stack_transform(views, len(values), first, last, weights)


def _chirps(slopes: Tensor, n_views: int, kx: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Factors that carry out `sum_u exp(2 pi i s (u - u0) kx)` for all planes as a convolution, complex128.

    They are multiplied with the views, [U, 1, 1, K], with the views' transforms along u padded to M, [M, 1, 1, K], and
    with the planes, [N, 1, 1, K]: the last are the same for all rows of views, so left to the end.
    """
    n_planes, frequencies = len(slopes), kx[None, None, :]
    middle, step = (slopes[0] + slopes[-1]) / 2, (slopes[-1] - slopes[0]) / max(n_planes - 1, 1)
    u, j = (geometry.angular_offsets(n)[:, None, None, None] for n in (n_views, n_planes))
    padded = fourier.next_fast(n_views + n_planes - 1)
    lag = torch.arange(padded, dtype=torch.float64)[:, None, None, None]
    lag = torch.where(lag < n_planes, lag, lag - padded) + j[0] - u[0]
    return (
        _turned(frequencies * (middle * u + step * u**2 / 2)),
        torch.fft.fft(_turned(-frequencies * step * lag**2 / 2), dim=0),
        _turned(frequencies * step * j**2 / 2),
    )


def _turned(turns: Tensor) -> Tensor:
    """exp(2 pi i turns); whole turns are taken off first, since the squares are large."""
    angle = 2 * torch.pi * (turns - turns.round())
    return torch.polar(torch.ones_like(angle), angle)
