"""Exposure: views, or channels of them, that are brighter or darker throughout than the central view.

After vignetting, which is 1 in the middle of every view, what is left is one gain for each view and channel.
Letters: `V U` view rows and columns, `C` channels, `n` windows.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref.captures.brightness import Ratios
from lfref.captures.defect import Correction, Evidence
from lfref.lightfield import LightField

SURE = 6.0  # standard errors
SHOWN = 0.02  # logarithm of a gain that shows; where edges hide much of a scene without a defect, .016 is found
LEAST = 0.004  # of those that are corrected along with one that shows
MOST = 1.5  # logarithm: a view that is darker than to a fifth is not dark by its exposure
LEAST_WINDOWS = 24
ROUNDS = 10
TILES = 5  # a side, that are taken to err on their own: highlights and edges are larger than windows


@dataclass(frozen=True, eq=False)
class Exposure:
    """Brightness of every view and channel over that of the central view."""

    name: ClassVar[str] = "exposure"

    gains: Tensor
    """1 where no difference is sure, float64, [V, U, C]."""
    error: float
    """Standard error of a gain, the median over views and channels."""

    def inert(self) -> str | None:
        """Nothing changes where no difference stands out from its error."""
        return None if bool((self.gains != 1).any()) else f"views and colours agree to {self.error:.2%}"

    def told(self) -> str:
        """How far gains reach, and how sure they are."""
        count, n_views = int((self.gains != 1).any(2).sum()), self.gains.shape[0] * self.gains.shape[1]
        span = f"{self.gains.min():.3f} to {self.gains.max():.3f}"
        return f"{count} of {n_views} views are {span} as bright as the central one, known to {self.error:.2%}"

    def corrected(self, field: LightField) -> LightField:
        """Views over their gains."""
        gains = self.gains[..., None, None].to(field.views)
        return dataclasses.replace(field, views=field.views / gains)


def find(evidence: Evidence) -> Exposure:
    """Find the gain of every view and channel.

    Args:
        evidence: Of the light field, without its vignetting.
    """
    field = evidence.field
    none = torch.ones(*field.grid, field.views.shape[2], dtype=torch.float64)
    if max(field.grid) < 2:
        return Exposure(none, 0.0)
    found = evidence.ratios
    level, error = levels(found)
    is_enough = found.known.sum(2, keepdim=True) >= LEAST_WINDOWS
    is_sure = (level.abs() > SURE * error) & (level.abs() < MOST) & is_enough
    shows = bool((is_sure & (level.abs() > SHOWN)).any())
    gains = torch.where(is_sure & (level.abs() > LEAST), level.exp(), 1.0).to(none) if shows else none
    return Exposure(gains, float(error[is_enough.expand_as(error)].median()) if bool(is_enough.any()) else 0.0)


def levels(ratios: Ratios) -> tuple[Tensor, Tensor]:
    """Where most logarithms of each view and channel lie, and the standard error of that, [V, U, C] each.

    Args:
        ratios: Of the light field.
    """
    known = ratios.known[:, :, None].expand_as(ratios.log)
    level = torch.where(known, ratios.log, torch.nan).nanmedian(3, keepdim=True).values.nan_to_num()
    scale = 2 * 1.4826 * torch.where(known, (ratios.log - level).abs(), torch.nan).nanmedian(3, keepdim=True).values
    scale = scale.nan_to_num().clamp(min=1e-3)
    for _ in range(ROUNDS):
        weight = known / (1 + ((ratios.log - level) / scale).square()).square()
        total = weight.sum(3, keepdim=True).clamp(min=1e-6)
        level = (weight * ratios.log).sum(3, keepdim=True) / total
    pulls = torch.zeros(*level.shape[:3], TILES**2).to(level)
    pulls.index_add_(3, _tiles(ratios), weight * (ratios.log - level))
    return level[..., 0], (pulls / total).square().sum(3).sqrt()


def _tiles(ratios: Ratios) -> Tensor:
    """Which tile of the picture each window lies in, [n]."""
    rows, columns = ratios.shape
    row = torch.arange(rows) * TILES // rows
    return (row[:, None] * TILES + torch.arange(columns) * TILES // columns).flatten()


EXPOSURE = Correction(Exposure, "windows that all views show", find, needs_light=True)
