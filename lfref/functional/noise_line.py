"""The noise line: variance a x + b of the noise at light x, measured in the flattest blocks of a light field's views.

The noise of interpolated samples, as after demosaicing, is correlated between neighbours. Only the part of it that
changes from pixel to pixel is measured, so that the result is too small for such samples.
Source: Immerkaer, "Fast Noise Variance Estimation", 1996 (the filter); Foi et al., "Practical Poissonian-Gaussian Noise
Modeling and Fitting for Single-Image Raw-Data", 2008 (the model).
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.lightfield import LightField

BLOCK = 8
"""Side of a block in pixels."""
BINS = 8
"""Number of levels of light; each level has the same number of blocks."""
FLAT = 0.1
"""Share of a level's blocks that count as flat."""
FLAT_VARIANCE = 0.539
"""Mean variance of the flattest tenth of blocks of pure noise, in units of the noise's variance."""
LEAST_BLOCKS = 20
"""Least number of blocks in a level."""
ENERGY = 36.0
"""Sum of the filter's squared weights."""
SAMPLES = 1 << 19
"""Approximate number of samples that are measured."""


def measure(field: LightField) -> tuple[float, float]:
    """Variance per unit of light, a, and in the dark, b; both are 0 if views are too small for a measurement."""
    # Channels of some evenly spread views; if there are fully weighted views, only of these.
    n_rows, n_columns, n_channels, height, width = field.views.shape
    count = max(1, min(n_rows * n_columns, SAMPLES // (n_channels * height * width)))
    candidates = torch.arange(n_rows * n_columns)
    if field.weight is not None:
        full = torch.stack([row.flatten(1)[:, ::97].amin(1) > 0 for row in field.weight]).flatten().cpu()
        candidates = candidates[full] if bool(full.any()) else candidates
    places = candidates[torch.linspace(0, len(candidates) - 1, 2 * count + 1)[1::2].round().long()]
    pictures = field.views.flatten(0, 1)[places].flatten(0, 1).float()
    if min(pictures.shape[-2:]) < BLOCK + 2:
        return 0.0, 0.0
    light, variance = blocks(pictures)
    usable = (light > 0) & (light < 0.95) & variance.isfinite()
    return _line(*_flattest(light[usable], variance[usable]))


def blocks(pictures: Tensor) -> tuple[Tensor, Tensor]:
    """Mean light and variance of all blocks of pictures, each in one row.

    Args:
        pictures: Pictures of at least 10 x 10 pixels, [B, H, W].
    """
    # Second differences along both axes remove smooth parts.
    across = pictures[..., 2:] - 2 * pictures[..., 1:-1] + pictures[..., :-2]
    rough = across[:, 2:] - 2 * across[:, 1:-1] + across[:, :-2]
    variance = F.avg_pool2d(rough.square()[None], BLOCK)[0] / ENERGY
    light = F.avg_pool2d(pictures[None, :, 1:-1, 1:-1], BLOCK)[0]
    return light.flatten(), variance.flatten()


def _flattest(light: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Light and variance of the flattest blocks at each level of light, at most [BINS] both."""
    n_bins = max(1, min(BINS, len(light) // LEAST_BLOCKS))
    order = light.argsort()
    levels = [(light[part], variance[part]) for part in order.tensor_split(n_bins) if len(part)]
    flattest = []
    for own_light, own_variance in levels:
        n_flat = max(1, int(FLAT * len(own_variance)))
        flat = own_variance.argsort()[:n_flat]
        flattest.append((own_light[flat].mean(), own_variance[flat].mean() / FLAT_VARIANCE))
    if not flattest:
        return light.new_zeros(0), light.new_zeros(0)
    lights, variances = zip(*flattest, strict=True)
    return torch.stack(lights), torch.stack(variances)


def _line(light: Tensor, variance: Tensor) -> tuple[float, float]:
    """(a, b), both at least 0, of the line a x + b that fits the lowest variances: texture only adds variance."""
    if not len(light) or not float(variance.max()) > 0:
        return 0.0, 0.0
    x, y = light.double(), variance.double()
    weight = (y + 1e-3 * y.max()) ** -2
    for _ in range(10):
        shot, read = _least_squares(x, y, weight)
        above = y / (shot * x + read).clamp(min=1e-12) - 1
        # Texture only adds variance: levels above the line count less.
        weight = (shot * x + read + 1e-3 * y.max()) ** -2 / (1 + (above.clamp(min=0) / 0.2).square()) ** 2
    return shot, read


def _least_squares(x: Tensor, y: Tensor, weight: Tensor) -> tuple[float, float]:
    total, mean_x, mean_y = weight.sum(), (weight * x).sum() / weight.sum(), (weight * y).sum() / weight.sum()
    slope = (weight * (x - mean_x) * (y - mean_y)).sum() / (weight * (x - mean_x).square()).sum().clamp(min=1e-12)
    if slope <= 0 or float(total) == 0:
        return 0.0, float(mean_y)
    if slope * mean_x > mean_y:
        return float((weight * x * y).sum() / (weight * x * x).sum()), 0.0
    return float(slope), float(mean_y - slope * mean_x)
