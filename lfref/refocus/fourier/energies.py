"""The disparities that a light field holds, and how much of its light is at each, found in its own spectra.

At some hundred frequencies the views, L = sum_k A_k f_k + noise with A the phases of layer k in each view, are modelled
with layers whose energies p are the same at all frequencies. Expectation maximisation raises the likelihood step by
step: the mean and variance of f under the present p, then p = mean of |f|^2 + variance. A layer fades away if the
others explain all that it explains. A focus measure cannot do that: the aperture blurs it along the disparities.

Numbers stay on the device of the views, and are real, so that a file can hold the same: products of layers are real
where opposite views weigh the same; elsewhere, real and imaginary parts are unknowns of their own. Where the host does
not know how many layers are needed, there are as many as the widest range needs, those beyond the range without energy.
Letters: `V U` view rows and columns, `M` views, `K` layers, `F` frequencies that are sampled, `ky kx` frequency in
cycles per pixel.
Source: Tipping, "Sparse Bayesian Learning and the Relevance Vector Machine", 2001.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import fourier, positive_definite
from lfref.functional.devices import BEYOND, at_most, number, on_device, on_host
from lfref.refocus import batches
from lfref.refocus.focus.slope_range import DisparityRange

REACH = 4.0
"""Disparities that are always tried, to either side of 0, in pixels per view step; `wide_range` may widen them."""
SPACING = 1.25
"""Largest distance of neighbouring layers in the outermost view, in pixels: light between two layers is blurred by half
of it."""
MOST_LAYERS = 96
"""Largest number of layers that a wide range gets: each layer needs the memory of a picture."""
STEP = 0.25
"""Distance of the layers that are tried, in pixels per view step."""
LEAST_SHARE = 0.01
"""Share of the energy that layers beyond the scene's range get from noise and occlusion: less does not count."""
OVER_NOISE = 2
"""Nor do shares below so many times the lower quartile of all: noise falls on all layers alike."""
N_STEPS = 8
"""Steps of the expectation maximisation."""
QUIET, QUIET_VARIANCE = 0.25, 0.9
"""Share of the frequencies that show nothing but noise, at most; what is left there of noise of variance 1."""
LOWEST, HIGHEST = 1 / 24, 0.4
"""Lowest and highest frequency that is read, in cycles per pixel: below, all layers look alike; above, views alias."""
AT_ONCE = 8
"""Views that are transformed at once."""
N_RADII, N_ANGLES = 12, 24
"""Circles of frequencies that are read, whose radii grow in equal ratios, and angles on each."""


class Energies(NamedTuple):
    """What layers hold of a light field."""

    disparities: Tensor
    """In pixels per view step, evenly spaced, float64, [K]."""
    shares: Tensor
    """Shares of the energy at any frequency, together 1, float64, [K]."""
    noise: Tensor
    """Variance of white noise in the grey views, in square light: an upper bound, as layers leave more than noise."""


class _Sample(NamedTuple):
    """Views at some frequencies: each frequency of energy 1, each view times the root of its weight."""

    real: Tensor
    """Float64, [F, M]."""
    imaginary: Tensor
    """[F, M]."""
    turns: Tensor
    """kx (u - u0) + ky (v - v0), [F, M]."""
    roots: Tensor
    """Roots of the views' weights, [M]."""
    is_symmetric: bool
    """Whether opposite views weigh the same."""
    variance: Tensor
    """Variance of white noise that has all the energy of a frequency, in square light, [F]."""
    counts: Tensor
    """1, or 0 where an earlier frequency is the same, [F]."""


def estimate_energies(grey: Tensor, n_layers: int, aperture: Tensor, known: DisparityRange | None = None) -> Energies:
    """At least `n_layers` even layers, `SPACING` apart or less, over the disparities that grey views [V, U, H, W] hold.

    The aperture [V, U] is of sum 1; `known` is the range of the disparities, if it is wide.
    """
    if n_layers < 1:
        raise InputError("n_layers must be at least 1", got=n_layers)
    (offsets, weights), pictures = _in_a_row(aperture), grey.flatten(0, 1)
    sample = _sampled(pictures, offsets, weights)
    low, high = _held(sample, pictures, offsets, known)
    layers_per_pixel = (max(aperture.shape) - 1) / 2 / SPACING
    first, last = farthest(known)
    least = max(n_layers, 2)
    most = max(least, min(1 + math.ceil((last - first + STEP) * layers_per_pixel), MOST_LAYERS))
    n_needed = (1 + ((high - low) * layers_per_pixel).ceil()).clamp(max=MOST_LAYERS).clamp(min=least)
    place = torch.arange(at_most(n_needed, most), dtype=torch.float64, device=grey.device)
    return _maximised(sample, low + (high - low) / (n_needed - 1) * place, place < n_needed)


def farthest(known: DisparityRange | None) -> tuple[float, float]:
    """Ends of the disparities that are tried; `known`: the range of a scene that is wide."""
    return (-REACH, REACH) if known is None else (min(-REACH, known.low), max(REACH, known.high))


def energy_range(grey: Tensor, aperture: Tensor, known: DisparityRange | None) -> tuple[Tensor, Tensor]:
    """Least and largest disparity at which the spectra of grey views hold light; arguments as above."""
    return range_of_cameras(grey.flatten(0, 1), *_in_a_row(aperture), known)


def range_of_cameras(
    grey: Tensor, offsets: Tensor, weights: Tensor, known: DisparityRange | None, tail: float = 0.0
) -> tuple[Tensor, Tensor]:
    """`energy_range` of views [M, H, W] from cameras at offsets (v, u) in view steps, [M, 2]; weights [M] of sum 1.

    A share `tail` of the light is left out at either end.
    """
    return _held(_sampled(grey, offsets, weights), grey, offsets, known, tail)


@on_host
def _in_a_row(aperture: Tensor) -> tuple[Tensor, Tensor]:
    """Offsets (v, u) of the views of a grid, [M, 2], and their weights, [M]."""
    return batches.even((aperture.shape[0], aperture.shape[1])).flatten(0, 1), aperture.flatten()


@on_host
def _is_symmetric(offsets: Tensor, weights: Tensor) -> bool:
    """Whether opposite views weigh the same."""
    return torch.allclose(offsets, -offsets.flip(0)) and torch.allclose(weights, weights.flip(0))


@on_host
def _spans(offsets: Tensor) -> tuple[float, float]:
    """Distances of the outermost views along both axes, at least one view step."""
    down, across = (offsets.amax(0) - offsets.amin(0)).clamp(min=1).tolist()
    return down, across


def _sampled(grey: Tensor, offsets: Tensor, weights: Tensor) -> _Sample:
    """Grey views [M, H, W] at some hundred frequencies."""
    height, width = (number(length, grey) for length in grey.shape[1:])
    radii = torch.logspace(math.log10(LOWEST), math.log10(HIGHEST), N_RADII, dtype=torch.float64, device=grey.device)[
        :, None
    ]
    angles = torch.pi * ((torch.arange(N_ANGLES, dtype=torch.float64, device=grey.device) + 0.5) / N_ANGLES - 0.5)
    y, x = (radii * angles.sin() * height).flatten().round(), (radii * angles.cos() * width).flatten().round()
    # Circles of small pictures share bins.
    code, place = y * width + x, torch.arange(len(y), device=grey.device)
    is_earlier = (code[:, None] == code) & (place[:, None] > place)
    # Some views at a time: all spectra together take as much memory as the views.
    spectra = torch.cat([fourier.at_bins(part, y.long(), x.long()) for part in grey.split(AT_ONCE)], 1).double()
    roots = on_device(weights, grey.device, torch.float64).sqrt()
    weighted = spectra.mT * roots  # [2, F, M]
    energy = weighted.square().sum((0, 2))
    # Black views have no energy.
    real, imaginary = weighted / energy.sqrt().clamp(min=torch.finfo(torch.float32).tiny)[:, None]
    v, u = on_device(offsets, grey.device, torch.float64).T
    return _Sample(
        real,
        imaginary,
        (y / height)[:, None] * v + (x / width)[:, None] * u,
        roots,
        _is_symmetric(offsets, weights),
        energy / (height * width),
        (is_earlier.sum(1) == 0).double(),
    )


def _held(
    sample: _Sample, grey: Tensor, offsets: Tensor, known: DisparityRange | None, tail: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Ends of the layers that hold light, of a grid of layers as far as the scene reaches and the views can shift."""
    low, high = farthest(known)
    sides = [number(length, grey) / span - STEP for span, length in zip(_spans(offsets), grey.shape[1:], strict=True)]
    limit = torch.minimum(*sides)
    tried = STEP * torch.arange(
        math.floor(low / STEP), math.ceil(high / STEP) + 1, dtype=torch.float64, device=grey.device
    )
    n_side = (limit / STEP).ceil().clamp(min=0)
    is_tried = tried.abs() <= n_side * STEP
    shares = _maximised(sample, tried, is_tried).shares
    least = (OVER_NOISE * quantile(shares, is_tried, 0.25)).clamp(min=LEAST_SHARE)
    is_held = is_tried & (shares >= torch.minimum(least, shares.amax(0)))
    held = torch.where(is_held, shares, 0.0)
    below, above = held.cumsum(0), held.flip(0).cumsum(0).flip(0)
    first = torch.where(is_held & (below >= tail * held.sum()), tried, BEYOND).amin(0)
    last = torch.where(is_held & (above >= tail * held.sum()), tried, -BEYOND).amax(0)
    if known is not None:
        # Spectra miss surfaces that fill little of the picture, which the sweep over small views has found.
        first, last = first.clamp(max=known.sure[0]), last.clamp(min=known.sure[1])
    return first - STEP / 2, last + STEP / 2


def _maximised(sample: _Sample, disparities: Tensor, is_tried: Tensor) -> Energies:
    """The energies of layers [K], those that are tried, under which the sample is most likely, as far as steps lead."""
    cosines, sines = fourier.waves(sample.turns[..., None] * disparities) * sample.roots[:, None]
    forth, back = torch.cat([cosines, sines], 1), torch.cat([cosines, -sines], 1)  # [F, 2 M, K]
    views = torch.stack([torch.cat([sample.real, sample.imaginary], 1), torch.cat([sample.imaginary, sample.real], 1)])
    gram = forth.mT @ forth
    explained = torch.cat([back.mT @ views[0, ..., None], forth.mT @ views[1, ..., None]], 2)  # [F, K, 2]
    if not sample.is_symmetric:
        crossed = torch.cat([sines, -cosines], 1).mT @ forth
        gram = torch.cat([torch.cat([gram, -crossed], 2), torch.cat([crossed, gram], 2)], 1)
        explained = torch.cat(explained.split(1, 2), 1)
    n_layers = len(disparities)
    energy = views[0].square().sum(1)
    n_views = 1 / sample.roots.pow(4).sum()  # as many equal weights would be as uneven
    counts = sample.counts / sample.counts.sum()
    shares, noise = is_tried.double() / is_tried.sum(), torch.full_like(energy[0], 0.01)
    eye = torch.eye(gram.shape[-1], dtype=gram.dtype, device=gram.device)
    rest = freedom = energy
    for _ in range(N_STEPS):
        # Expectation: mean of the layers and their variance. Written with roots of the shares, which may reach 0: the
        # mean is root x, and what it explains is x^T (root explained) + noise x^T x.
        root = shares.sqrt()
        every = root if sample.is_symmetric else root.repeat(2)
        matrices = torch.addcmul(every[:, None] * gram * every, eye, noise)
        x, explained_energy, diagonal = positive_definite.solved_with_energies(matrices, every[:, None] * explained)
        power = x.square().sum(2)
        rest = energy - explained_energy - noise * power.sum(1)
        variance = noise * diagonal[:, :n_layers]
        freedom = n_views - n_layers + variance.sum(1)
        # Maximisation: shares and noise that make this expectation most likely. A scene of layers at exactly these
        # disparities leaves no noise, and a noise of 0 no inverse.
        power = power if sample.is_symmetric else power[:, :n_layers] + power[:, n_layers:]
        shares = shares * (counts @ (power + variance))
        noise = ((counts @ rest) / (counts @ freedom)).clamp(min=1e-6)
    # Occlusion and gloss add to what is left, at some frequencies more than at others.
    left = rest.clamp(min=0) / freedom * n_views * sample.variance
    return Energies(disparities, shares / shares.sum(), quantile(left, sample.counts > 0, QUIET) / QUIET_VARIANCE)


def quantile(values: Tensor, is_counted: Tensor, share: float) -> Tensor:
    """Quantile of the values [n] that count, between two of them in proportion."""
    ordered = torch.where(is_counted, values, BEYOND).sort().values
    place = share * (is_counted.sum() - 1)
    below = place.floor()
    low, high = (ordered.gather(0, at.long()[None])[0] for at in (below, place.ceil()))
    return low + (place - below) * (high - low)
