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

from lfref.functional.devices import BEYOND, length_of, on_device
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
N_STEPS = 5
"""Steps of the fit of a line: in the median of sim30 the noise is within 1e-6 of what 40 steps find."""
TINY, APART = 1e-30, 1e4
"""Least power; distance of two levels in logarithms of power."""


def measure(field: LightField) -> tuple[float, float]:
    """Variance per unit of light, a, and in the dark, b; both are 0 if views are too small for a measurement."""
    shot, read = measured(field.views, field.weight)
    return float(shot), float(read)


def measured(views: Tensor, weight: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """As `measure`, for views [V, U, C, H, W] and the weight of their samples [V, U, 1, H, W], on their device."""
    # Channels of some evenly spread views; if there are views of which all samples have weight (one in 97 is looked
    # at), only of these.
    n_rows, n_columns, n_channels, height, width = views.shape
    candidates = torch.arange(n_rows * n_columns, device=views.device)
    if weight is not None:
        full = torch.stack([row.flatten(1)[:, ::97].amin(1) > 0 for row in weight]).flatten()
        candidates = candidates[full] if bool(full.any()) else candidates
    count = n_views_read(n_rows * n_columns, n_channels, height, width)
    place = (
        (2 * torch.arange(count, dtype=torch.float64, device=views.device) + 1) * (len(candidates) - 1) / (2 * count)
    )
    chosen = candidates.index_select(0, place.round().long())
    pictures = views.flatten(0, 1).index_select(0, chosen).flatten(0, 1).float()
    if height < BLOCK + 2 or width < BLOCK + 2:
        return pictures.new_zeros((), dtype=torch.float64), pictures.new_zeros((), dtype=torch.float64)
    return fitted_line(*_levels(*blocks(pictures)))


def n_views_read(n_views: int, n_channels: int, height: int, width: int) -> int:
    """Number of views that hold about `SAMPLES` samples, at least 1."""
    if not torch.compiler.is_exporting():
        return max(1, min(n_views, SAMPLES // (n_channels * height * width)))
    n_samples = torch.full((), n_channels) * torch.full((), height) * torch.full((), width)
    most = torch.div(torch.full((), SAMPLES), n_samples, rounding_mode="floor")
    return length_of(most.clamp(min=1).clamp(max=n_views))


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
    spectra = each @ on_device(WAVES, each.device)
    power = spectra.square().unflatten(1, (2, -1)).sum(1)
    return F.avg_pool2d(inner[None], BLOCK)[0].flatten(), power / on_device(POWER, each.device)


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


def _levels(light: Tensor, power: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Light of the levels, variance of their quiet part, and 1 if there is such a level, else 0: [BINS], float64.

    Of blocks with mean light [M] and power [M, F]; nothing is read on the host, so that there are always `BINS` levels.
    """
    usable = (light > 0) & (light < BRIGHTEST) & power.isfinite().all(1)
    n_blocks = usable.sum()
    n_levels = (n_blocks // LEAST_BLOCKS).clamp(min=1).clamp(max=BINS)
    size, n_larger = n_blocks // n_levels, n_blocks % n_levels
    level = torch.arange(BINS, device=light.device)
    first, counts = level * size + torch.minimum(level, n_larger), size + (level < n_larger).long()
    # Blocks by their light, those that count first; and the level of each.
    ordered = torch.where(usable, light, BEYOND).double().sort()
    rank = torch.arange(light.shape[0], device=light.device)
    of_level = (rank >= first[:, None]) & (rank < (first + counts)[:, None]) & (level < n_levels)[:, None]
    number = torch.where(of_level.any(0), of_level.long().argmax(0), BINS)
    lights = torch.where(of_level, ordered.values, 0.0).sum(1) / counts.clamp(min=1)
    # All levels are sorted by their power at once: the logarithm is far smaller than the distance of two levels.
    keys = power.index_select(0, ordered.indices).T.double().clamp(min=TINY).log() + APART * number
    place = first + (QUIET_BLOCKS * counts).round().long().clamp(min=1) - 1
    at = place.clamp(max=light.shape[0] - 1)
    by_frequency = (keys.sort().values.index_select(1, at) - APART * level).exp()  # [F, BINS]
    quiet = by_frequency.sort(0).values[max(1, round(QUIET_FREQUENCIES * len(by_frequency))) - 1] / QUIET_VARIANCE
    exists = (level < n_levels) & (counts > 0)
    return lights, torch.where(exists, quiet, 0.0), exists.double()


def fitted_line(light: Tensor, variance: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """(a, b), both at least 0, of the line a x + b that fits the lowest variances: texture only adds variance.

    Of levels of light [n], those with a count of 0 do not count.
    """
    scale = (counts * variance).amax(0).clamp(min=torch.finfo(torch.float32).tiny)
    relative = variance / scale
    weight = counts * (relative + 1e-3) ** -2
    # One product of a table and the weights gives all sums of the least squares.
    one = torch.ones_like(light)
    table = torch.stack([one, light, relative, light * light, light * relative])
    shot = read = torch.zeros_like(scale)
    for _ in range(N_STEPS):
        shot, read = _least_squares(*(table @ weight).unbind(0))
        line = torch.addcmul(read, shot, light)
        # Texture only adds variance: levels above the line count less.
        above = (relative / line.clamp(min=1e-12) - 1).clamp(min=0) / 0.2
        weight = counts / ((line + 1e-3) * torch.addcmul(one, above, above)).square()
    return scale * shot, scale * read


def _least_squares(total: Tensor, x: Tensor, y: Tensor, xx: Tensor, xy: Tensor) -> tuple[Tensor, Tensor]:
    """Slope and height, both at least 0, of a line by sums over its points."""
    n = total.clamp(min=1e-12)
    mean_x, mean_y = x / n, y / n
    slope = (xy - mean_x * y) / (xx - mean_x * x).clamp(min=1e-12)
    shot = slope.clamp(min=0)
    read = mean_y - shot * mean_x
    return torch.where(read < 0, xy / xx.clamp(min=1e-12), shot), read.clamp(min=0)
