"""The noise line: variance a x + b of the noise at light x, measured in the quietest parts of the views' spectra.

White noise has the same power in all blocks of a picture and at all frequencies. Texture adds power in some blocks and
at some frequencies only. So each level of light is measured where its power is least: at each frequency the quiet tenth
of the blocks counts, and of the frequencies the quiet quarter.
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
QUIET_BLOCKS, QUIET_FREQUENCIES = 0.1, 0.25
"""Shares of a level's blocks, and of the frequencies, that count as quiet."""
QUIET_VARIANCE = 0.097
"""What is measured there of pure noise of variance 1: about the first tenth of an exponential distribution."""
LEAST_BLOCKS = 500
"""Least number of blocks in a level."""
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
    usable = (light > 0) & (light < 0.95) & variance.isfinite().all(1)
    return _line(*_quietest(light[usable], variance[usable]))


def blocks(pictures: Tensor) -> tuple[Tensor, Tensor]:
    """Mean light of all blocks of pictures, [M], and their power at F high frequencies, [M, F].

    Power is scaled so that white noise has its variance as power.

    Args:
        pictures: Pictures of at least 10 x 10 pixels, [B, H, W].
    """
    power = _power(pictures)
    # Impulses say what each frequency takes of white noise.
    impulses = torch.eye((BLOCK + 2) ** 2, device=pictures.device).unflatten(1, (BLOCK + 2, BLOCK + 2))
    light = F.avg_pool2d(pictures[None, :, 1:-1, 1:-1], BLOCK)[0]
    return light.flatten(), power / _power(impulses).sum(0)


def _power(pictures: Tensor) -> Tensor:
    """Power of the blocks of pictures [B, H, W] at high frequencies along both axes, [M, F]."""
    # Second differences along both axes remove smooth parts.
    across = pictures[..., 2:] - 2 * pictures[..., 1:-1] + pictures[..., :-2]
    rough = across[:, 2:] - 2 * across[:, 1:-1] + across[:, :-2]
    each = rough.unfold(1, BLOCK, BLOCK).unfold(2, BLOCK, BLOCK).flatten(0, 2)
    window = torch.hann_window(BLOCK, device=pictures.device)
    spectra = torch.fft.rfft2(each * window[:, None] * window)
    # From a quarter of a cycle per pixel on; the very last frequency, which is real, is distributed differently.
    quarter, half = BLOCK // 4, BLOCK // 2
    high = spectra[:, quarter : BLOCK - quarter + 1, quarter:].abs().square()
    is_last = torch.zeros(high.shape[1:], dtype=torch.bool, device=pictures.device)
    is_last[half - quarter, half - quarter] = True
    return high[:, ~is_last]


def _quietest(light: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Light of the levels and variance of their quiet part, at most [BINS] both, for blocks [M] and [M, F]."""
    n_bins = max(1, min(BINS, len(light) // LEAST_BLOCKS))
    quietest = []
    for part in light.argsort().tensor_split(n_bins):
        if len(part):
            by_frequency = _lowest(variance[part], QUIET_BLOCKS)
            quietest.append((light[part].mean(), _lowest(by_frequency, QUIET_FREQUENCIES) / QUIET_VARIANCE))
    if not quietest:
        return light.new_zeros(0), light.new_zeros(0)
    lights, variances = zip(*quietest, strict=True)
    return torch.stack(lights), torch.stack(variances)


def _lowest(values: Tensor, share: float) -> Tensor:
    """The value below which a share of the first axis lies."""
    return values.kthvalue(max(1, round(share * len(values))), 0).values


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
