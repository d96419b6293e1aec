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
BRIGHTEST = 0.95
"""Light from which blocks may be clipped, and do not count."""
LEAST_BLOCKS = 500
"""Least number of blocks in a level."""
SAMPLES = 1 << 19
"""Approximate number of samples that are measured."""


def measure(field: LightField) -> tuple[float, float]:
    """Variance per unit of light, a, and in the dark, b; both are 0 if views are too small for a measurement."""
    # Channels of some evenly spread views; if there are views of which all samples have weight (one in 97 is looked
    # at), only of these.
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
    usable = (light > 0) & (light < BRIGHTEST) & variance.isfinite().all(1)
    levels, quiet = (each.double() for each in _quietest(light[usable], variance[usable]))
    if not len(levels):
        return 0.0, 0.0
    shot, read = fitted_line(levels, quiet, torch.ones_like(levels))
    return float(shot), float(read)


def blocks(pictures: Tensor) -> tuple[Tensor, Tensor]:
    """Mean light of all blocks of pictures [B, H, W], [M], and their power at F high frequencies, [M, F].

    Power is scaled so that white noise has its variance as power.
    """
    inner = pictures[:, 1:-1, 1:-1]
    n_down, n_across = inner.shape[1] // BLOCK, inner.shape[2] // BLOCK
    # Second differences along both axes remove smooth parts.
    across = pictures[..., 2:] - 2 * pictures[..., 1:-1] + pictures[..., :-2]
    rough = across[:, 2:] - 2 * across[:, 1:-1] + across[:, :-2]
    whole = rough[:, : n_down * BLOCK, : n_across * BLOCK].unflatten(2, (n_across, BLOCK))
    each = whole.unflatten(1, (n_down, BLOCK)).transpose(2, 3).reshape(-1, BLOCK**2)
    spectra = each @ WAVES.to(each.device)
    power = spectra.square().unflatten(1, (2, -1)).sum(1)
    return F.avg_pool2d(inner[None], BLOCK)[0].flatten(), power / POWER.to(each.device)


def _waves() -> tuple[Tensor, Tensor]:
    """Real and imaginary parts of a block's high frequencies, [BLOCK BLOCK, 2 F], and their power in the second
    differences of white noise of variance 1, [F]."""
    window = torch.hann_window(BLOCK)
    impulses = torch.eye(BLOCK**2).unflatten(1, (BLOCK, BLOCK))
    # From a quarter of a cycle per pixel on; the very last frequency, which is real, is distributed differently.
    quarter, half = BLOCK // 4, BLOCK // 2
    high = torch.fft.rfft2(impulses * window[:, None] * window)[:, quarter : BLOCK - quarter + 1, quarter:]
    is_last = torch.zeros(high.shape[1:], dtype=torch.bool)
    is_last[half - quarter, half - quarter] = True
    chosen = high[:, ~is_last]
    # What each frequency takes of each pixel of the block and of its border.
    differences = torch.tensor([1.0, -2.0, 1.0])
    filters = (differences[:, None] * differences)[None, None]
    taken = [F.conv_transpose2d(part.T.unflatten(1, (1, BLOCK, BLOCK)), filters) for part in (chosen.real, chosen.imag)]
    power = sum(part.square().sum((1, 2, 3)) for part in taken)
    return torch.cat([chosen.real, chosen.imag], 1), torch.as_tensor(power)


WAVES, POWER = _waves()
"""The spectrum of a block as a matrix, and the power of white noise in it."""


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


def fitted_line(light: Tensor, variance: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """(a, b), both at least 0, of the line a x + b that fits the lowest variances: texture only adds variance.

    Of levels of light [n], those with a count of 0 do not count.
    """
    scale = (counts * variance).amax(0).clamp(min=torch.finfo(torch.float32).tiny)
    relative = variance / scale
    weight = counts * (relative + 1e-3) ** -2
    shot = read = torch.zeros_like(scale)
    for _ in range(10):
        shot, read = _least_squares(light, relative, weight)
        above = relative / (shot * light + read).clamp(min=1e-12) - 1
        # Texture only adds variance: levels above the line count less.
        line = shot * light + read + 1e-3
        weight = counts * line**-2 / (1 + (above.clamp(min=0) / 0.2).square()) ** 2
    return scale * shot, scale * read


def _least_squares(x: Tensor, y: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    total = weight.sum().clamp(min=1e-12)
    mean_x, mean_y = (weight * x).sum() / total, (weight * y).sum() / total
    slope = (weight * (x - mean_x) * (y - mean_y)).sum() / (weight * (x - mean_x).square()).sum().clamp(min=1e-12)
    through_0 = (weight * x * y).sum() / (weight * x * x).sum().clamp(min=1e-12)
    is_below_0, rises = slope * mean_x > mean_y, slope > 0
    shot = torch.where(rises, torch.where(is_below_0, through_0, slope), 0.0)
    return shot, torch.where(rises, torch.where(is_below_0, 0.0, mean_y - slope * mean_x), mean_y)
