"""Which disparities a light field holds, from its own spectra: the share of its light that each of many layers has.

At some hundred frequencies the views, L = sum_k A_k f_k + noise with A the phases of layer k in each view, are modelled
with layers whose energies p_k are the same at all frequencies. Expectation maximisation raises the likelihood step by
step: the mean and variance of f under the present p, then p = mean of |f|^2 + variance. A layer fades away if
the others explain all that it explains. A focus measure cannot do that: the aperture blurs it along the disparities.
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

REACH = 4.0
"""Largest disparity that is tried, in pixels per view step; callers give the disparities of scenes beyond it."""
STEP = 0.25
"""Distance of the layers that are tried, in pixels per view step."""
LEAST_SHARE = 0.01
"""Share of the energy that layers beyond the scene's range get from noise and occlusion: less does not count."""
OVER_NOISE = 3
"""Nor do shares below so many times the lower quartile of all: noise falls on all layers alike."""
N_STEPS = 8
"""Steps of the expectation maximisation."""
LOWEST, HIGHEST = 1 / 24, 0.4
"""Lowest and highest frequency that is read, in cycles per pixel: below, all layers look alike; above, views alias."""


class Energies(NamedTuple):
    """What layers hold of a light field."""

    disparities: Tensor
    """In pixels per view step, float64, CPU, [K]."""
    shares: Tensor
    """Shares of the energy at any frequency, together 1, float64, CPU, [K]."""


class _Sample(NamedTuple):
    """Views at some frequencies: each frequency of energy 1, each view times the root of its weight."""

    spectra: Tensor
    """Complex128, [F, V U]."""
    turns: Tensor
    """kx (u - u0) + ky (v - v0), [F, V U]."""
    roots: Tensor
    """Roots of the views' weights, [V U]."""


def estimate_energies(views: Tensor, n_layers: int, aperture: Tensor) -> Energies:
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
    # First layers on a grid about 0, as far as the views can shift; those that hold light span the range.
    limit = min(length / max(n - 1, 1) for n, length in zip(aperture.shape, views.shape[-2:], strict=True))
    n_sides = max(math.ceil(min(REACH, limit - STEP) / STEP), 0)
    wide = _maximised(sample, torch.arange(-n_sides, n_sides + 1, dtype=torch.float64) * STEP)
    least = max(LEAST_SHARE, OVER_NOISE * float(wide.shares.quantile(0.25)))
    held = wide.disparities[wide.shares >= min(least, float(wide.shares.max()))]
    ends = (float(held.min()) - STEP / 2, float(held.max()) + STEP / 2)
    return _maximised(sample, geometry.even_slopes(n_layers, *ends))


def _sampled(views: Tensor, aperture: Tensor) -> _Sample:
    height, width = views.shape[-2:]
    # The bins of `rfft2` nearest to 12 circles, whose radii grow in equal ratios, at 24 angles each.
    radius = torch.logspace(math.log10(LOWEST), math.log10(HIGHEST), 12, dtype=torch.float64)[:, None]
    angle = torch.pi * ((torch.arange(24, dtype=torch.float64) + 0.5) / 24 - 0.5)
    y, x = (radius * angle.sin() * height).round().long() % height, (radius * angle.cos() * width).round().long()
    bins = torch.unique(y * width + x)
    y, x = bins // width, bins % width
    grey = torch.stack([batches.radiance(row).sum(-3) for row in batches.without_unread(views[None], aperture)[0]])
    spectra = torch.fft.rfft2(grey)[..., y.to(views.device), x.to(views.device)].cpu().to(torch.complex128)
    roots = aperture.sqrt()
    weighted = (spectra * roots[..., None]).flatten(0, 1).T
    energy = weighted.abs().square().sum(1, keepdim=True)
    ky, kx = fourier.frequencies(height)[y, None, None], fourier.half_frequencies(width)[x, None, None]
    v, u = (geometry.angular_offsets(n_views) for n_views in aperture.shape)
    return _Sample(
        weighted / energy.sqrt().clamp(min=torch.finfo(torch.float32).tiny),  # black views have no energy
        (ky * v[:, None] + kx * u).flatten(1),
        roots.flatten(),
    )


def _maximised(sample: _Sample, disparities: Tensor) -> Energies:
    """The energies of these layers under which the sample is most likely, as far as the steps lead."""
    turns = -2 * torch.pi * sample.turns[..., None] * disparities
    model = torch.polar(sample.roots[:, None].expand_as(turns), turns)
    gram, explained = model.mH @ model, (model.mH @ sample.spectra[..., None])[..., 0]
    n_views = float(1 / sample.roots.pow(4).sum())  # as many equal weights would be as uneven
    shares, noise = torch.full_like(disparities, 1 / len(disparities)), 0.01
    eye = torch.eye(len(disparities), dtype=gram.dtype)
    for _ in range(N_STEPS):
        # Expectation: mean of the layers and their variance. Written with roots of the shares, which may reach 0.
        root = shares.sqrt()
        inverse = torch.cholesky_inverse(torch.linalg.cholesky(root[:, None] * gram * root + noise * eye))
        layers = root * (inverse @ (root * explained)[..., None])[..., 0]
        variance = noise * inverse.diagonal(dim1=1, dim2=2).real
        rest = (sample.spectra - (model @ layers[..., None])[..., 0]).abs().square().sum()
        # Maximisation: shares and noise that make this expectation most likely. A scene of layers at exactly these
        # disparities leaves no noise, and a noise of 0 no inverse.
        shares = (layers.abs().square() + shares * variance).mean(0)
        noise = max(float(rest) / float((n_views - (1 - variance).sum(1)).sum()), 1e-6)
    return Energies(disparities, shares / shares.sum())
