"""Which disparities a light field holds, from its own spectra: how much of the light each of many layers explains.

At some hundred frequencies the views are modelled as a sum of layers whose energies are the same at all of them.
Expectation maximisation finds the energies: a layer that explains nothing the others do not fades away. A focus measure
cannot tell that: it is blurred along the disparities by the width of the aperture.
Letters: `d` disparity in pixels per view step, `K` layers, `F` frequencies, `kx ky` frequency in cycles per pixel.
Source: Tipping, "Sparse Bayesian Learning and the Relevance Vector Machine", 2001.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import fourier
from lfref.refocus import batches

REACH, STEP = 4.0, 0.25  # pixels per view step: where disparities are looked for
LEAST_SHARE = 0.01  # of the energy: what layers beyond the scene's range get from noise and occlusion is below it
OVER_NOISE = 3  # times what a quarter of all candidates has less of, since noise falls on all alike
N_STEPS = 8
RADII, ANGLES = 12, 24  # of the frequencies looked at
LOWEST, HIGHEST = 1 / 24, 0.4  # cycles per pixel: below, all layers look alike; above, views alias
LEAST_NOISE = 1e-6  # of the energy: a scene of layers at the very disparities leaves none


class Energies(NamedTuple):
    """What layers hold of a light field."""

    disparities: Tensor
    """In pixels per view step, float64, CPU, [K]."""
    shares: Tensor
    """Of the energy at any frequency, all of them 1 together, float64, CPU, [K]."""


def found(views: Tensor, n_layers: int, aperture: Tensor) -> Energies:
    """Evenly spaced layers over the range of disparities that a light field holds.

    Args:
        views: Light field, [V, U, C, H, W].
        n_layers: Number of layers, >= 1.
        aperture: Weight of each view, their sum 1, [V, U].

    Raises:
        InputError: Views that are not finite.
    """
    sample = _sampled(views.detach(), aperture)
    if not bool(sample.spectra.isfinite().all()):
        raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file, or give disparities")
    wide = _of_layers(sample, _candidates(aperture.shape, views.shape[-2:]))
    least = max(LEAST_SHARE, OVER_NOISE * float(wide.shares.quantile(0.25)))
    seen = wide.disparities[wide.shares >= min(least, float(wide.shares.max()))]
    ends = (float(seen.min()) - STEP / 2, float(seen.max()) + STEP / 2)
    return _of_layers(sample, geometry.even_slopes(n_layers, *ends))


def even(disparities: Tensor) -> Energies:
    """Layers that hold the same share each.

    Args:
        disparities: In pixels per view step, [K].
    """
    return Energies(disparities, torch.full_like(disparities, 1 / len(disparities)))


class _Sample(NamedTuple):
    """Views at some frequencies, of energy 1 each, times the root of the views' weights."""

    spectra: Tensor
    """Complex128, [F, V U]."""
    rows: Tensor
    """ky (v - v0) of each, [F, V U]."""
    columns: Tensor
    """kx (u - u0) of each, [F, V U]."""
    roots: Tensor
    """Of the weights, [V U]."""


def _candidates(grid: torch.Size, size: torch.Size) -> Tensor:
    """Disparities on a grid of `STEP` about 0, as far as the views can shift."""
    limit = min(length / max(n_views - 1, 1) for n_views, length in zip(grid, size, strict=True))
    n_sides = math.ceil(min(REACH, limit - STEP) / STEP)
    return torch.arange(-n_sides, n_sides + 1, dtype=torch.float64) * STEP if n_sides > 0 else torch.zeros(1).double()


def _sampled(views: Tensor, aperture: Tensor) -> _Sample:
    height, width = views.shape[-2:]
    y, x = _frequencies(height, width)
    grey = torch.stack([batches.radiance(row).sum(-3) for row in batches.without_unread(views[None], aperture)[0]])
    spectra = torch.fft.rfft2(grey)[..., y.to(views.device), x.to(views.device)].cpu().to(torch.complex128)
    roots = aperture.sqrt()
    weighted = (spectra * roots[..., None]).flatten(0, 1).T
    energy = weighted.abs().square().sum(1, keepdim=True)
    ky, kx = fourier.frequencies(height)[y, None, None], fourier.half_frequencies(width)[x, None, None]
    rows, columns = (geometry.angular_offsets(n_views) for n_views in aperture.shape)
    shape = (len(y), *aperture.shape)
    return _Sample(
        weighted / energy.sqrt().clamp(min=torch.finfo(torch.float32).tiny),
        (ky * rows[:, None]).expand(shape).flatten(1),
        (kx * columns).expand(shape).flatten(1),
        roots.flatten(),
    )


def _frequencies(height: int, width: int) -> tuple[Tensor, Tensor]:
    """Bins of `rfft2` near circles whose radii grow in equal ratios, rows and columns, [F]."""
    radius = torch.logspace(math.log10(LOWEST), math.log10(HIGHEST), RADII, dtype=torch.float64)[:, None]
    angle = torch.pi * ((torch.arange(ANGLES, dtype=torch.float64) + 0.5) / ANGLES - 0.5)
    y, x = (radius * angle.sin() * height).round().long() % height, (radius * angle.cos() * width).round().long()
    bins = torch.unique(y * width + x)
    return bins // width, bins % width


def _of_layers(sample: _Sample, disparities: Tensor) -> Energies:
    """Energies of the layers under which the sample is most likely, as far as some steps lead."""
    turns = -2 * torch.pi * (sample.rows + sample.columns)[..., None] * disparities
    model = torch.polar(sample.roots[:, None].expand_as(turns), turns)
    gram, seen = model.mH @ model, (model.mH @ sample.spectra[..., None])[..., 0]
    n_views = float(1 / sample.roots.pow(4).sum())
    shares, noise = torch.full_like(disparities, 1 / len(disparities)), 0.01
    eye = torch.eye(len(disparities), dtype=gram.dtype)
    for _ in range(N_STEPS):
        root = shares.sqrt()
        inverse = torch.cholesky_inverse(torch.linalg.cholesky(root[:, None] * gram * root + noise * eye))
        layers = root * (inverse @ (root * seen)[..., None])[..., 0]
        unsure = noise * inverse.diagonal(dim1=1, dim2=2).real
        left = (sample.spectra - (model @ layers[..., None])[..., 0]).abs().square().sum()
        shares = (layers.abs().square() + shares * unsure).mean(0)
        noise = max(float(left) / float((n_views - (1 - unsure).sum(1)).sum()), LEAST_NOISE)
    return Energies(disparities, shares / shares.sum())
