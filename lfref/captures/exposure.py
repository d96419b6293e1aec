"""Exposure: views, or channels of them, that are brighter or darker throughout than the central view.

After the correction of vignetting, one gain for each view and channel remains. A file of its own, as each defect has.
Letters: `V U` view rows and columns, `C` channels, `n` windows.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref.captures.brightness import LEAST_WINDOWS, Ratios
from lfref.lightfield import LightField

SURE = 6.0  # standard errors, by trial
SHOWN = 0.02  # logarithm of a gain: where edges hide much of a scene without a defect, .016 is measured
LEAST = 0.004  # logarithm of gains that are corrected beside one that shows: half a level of 8 bits at 1/2
LARGEST = 1.5  # logarithm, by trial: a view with less than a fifth of the light has another defect
TILES = 5  # along a side, by trial: tiles are larger than highlights and edges, so their errors are about independent


@dataclass(frozen=True, eq=False)
class ExposureDefect:
    """Brightness of every view and channel, relative to the central view."""

    name: ClassVar[str] = "exposure"
    needs_light: ClassVar[bool] = True

    gains: Tensor
    """1 where no difference is certain, float64, [V, U, C]."""
    error: float
    """Standard error of a gain, the median over views and channels."""

    def reason_to_skip(self) -> str | None:
        """Why nothing is corrected: no gain differs from 1 by more than its error explains."""
        return None if bool((self.gains != 1).any()) else f"views and colours agree to {self.error:.2%}"

    def summary(self) -> str:
        """Range of the gains, and their error."""
        count, n_views = int((self.gains != 1).any(2).sum()), self.gains.shape[0] * self.gains.shape[1]
        span = f"{self.gains.min():.3f} to {self.gains.max():.3f}"
        views = f"{count} of {n_views} views " + ("is" if count == 1 else "are")
        return f"{views} {span} as bright as the central one, known to {self.error:.2%}"

    def corrected(self, field: LightField) -> LightField:
        """Views divided by their gains."""
        gains = self.gains[..., None, None].to(field.views)
        return dataclasses.replace(field, views=field.views / gains)


def find(ratios: Ratios) -> ExposureDefect:
    """Estimate the gain of every view and channel, in a field without vignetting."""
    level, error = levels(ratios)
    is_enough = (ratios.known.sum(2, keepdim=True) >= LEAST_WINDOWS).expand_as(error)
    typical = float(error[is_enough].median()) if bool(is_enough.any()) else 0.0
    return ExposureDefect(certain_gains(level, error.masked_fill(~is_enough, torch.inf)), typical)


def certain_gains(level: Tensor, error: Tensor) -> Tensor:
    """Gains from their logarithms and standard errors, 1 where none is certain; all 1 if none shows, [V, U, C]."""
    is_sure = (level.abs() > SURE * error) & (level.abs() < LARGEST)
    if not bool((is_sure & (level.abs() > SHOWN)).any()):
        return torch.ones_like(level, dtype=torch.float64, device="cpu")
    return torch.where(is_sure & (level.abs() > LEAST), level.exp(), 1.0).cpu().double()


def levels(ratios: Ratios) -> tuple[Tensor, Tensor]:
    """Robust mean of the logarithms of each view and channel, and its standard error, [V, U, C] each."""
    known = ratios.known[:, :, None].expand_as(ratios.log)
    level = torch.where(known, ratios.log, torch.nan).nanmedian(3, keepdim=True).values.nan_to_num()
    # Two standard deviations, from the median deviation: what is farther out hardly counts.
    scale = 2 * 1.4826 * torch.where(known, (ratios.log - level).abs(), torch.nan).nanmedian(3, keepdim=True).values
    scale = scale.nan_to_num().clamp(min=1e-3)
    for _ in range(10):  # number of rounds by trial
        weight = known / (1 + ((ratios.log - level) / scale).square()).square()
        total = weight.sum(3, keepdim=True).clamp(min=1e-6)
        level = (weight * ratios.log).sum(3, keepdim=True) / total
    rows, columns = ratios.shape
    row_tiles, column_tiles = torch.arange(rows) * TILES // rows, torch.arange(columns) * TILES // columns
    tiles = (row_tiles[:, None] * TILES + column_tiles).flatten()
    pulls = torch.zeros(*level.shape[:3], TILES**2).to(level)
    pulls.index_add_(3, tiles, weight * (ratios.log - level))
    return level[..., 0], (pulls / total).square().sum(3).sqrt()
