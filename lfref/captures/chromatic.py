"""Chromatic aberration: colours that differ in size (lateral) or in focus (axial) from the middle one.

Channel c reads at `m_c y + t_c + d_c p` what the middle channel reads at y: see `dispersion`. What is common to all
colours cannot be seen, and the middle colour stays as it is.
Letters: `C` channels, `p` place of a view, `y` pixel from the picture's centre, `m t d` as there.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref.captures import dispersion, resampled
from lfref.captures.correction import Correction
from lfref.captures.dispersion import Dispersion
from lfref.captures.evidence import Evidence
from lfref.captures.fitted import Fitted
from lfref.captures.registration import Registration, places_of, registered
from lfref.lightfield import LightField

SHOWN = 0.02  # pixels that colours lie apart, on the average over the picture or in the outermost view
SURE = 4.0  # standard errors
CLEAR = {"lateral": 0.6, "axial": 1.0}  # of the scatter of patches: textures of two colours lie apart here and there
LEAST_OFFSET = 0.03  # pixels


@dataclass(frozen=True, eq=False)
class Chromatic:
    """How each channel differs from the middle one."""

    name: ClassVar[str] = "chromatic"

    magnifications: Tensor
    """About the picture's centre, 1 where none is sure, float64, [C]."""
    offsets: Tensor
    """Down and right in pixels, 0 where none is sure, [C, 2]."""
    disparities: Tensor
    """Added to those of the scene, in pixels per view step, 0 where none is sure, [C]."""
    reason: str = ""
    """Why nothing was looked for, if so."""

    def inert(self) -> str | None:
        """Nothing moves where no colour surely differs."""
        if bool((self.magnifications != 1).any() | (self.offsets != 0).any() | (self.disparities != 0).any()):
            return None
        return self.reason or "colours agree in size and focus as far as can be told"

    def told(self) -> str:
        """What each channel differs in."""
        return "; ".join(filter(None, map(self._of_channel, range(len(self.magnifications))))) + (
            "; what all colours share cannot be known"
        )

    def corrected(self, field: LightField) -> LightField:
        """Channels in the size and focus of the middle one."""
        rows, columns = resampled.centred(field.size)
        sizes = self.magnifications[:, None]
        shifts = self.offsets + self.disparities[:, None] * places_of(field).unflatten(0, field.grid)[:, :, None]
        down, right = shifts[..., None, :].unbind(-1)
        return resampled.moved(field, sizes * rows + down, sizes * columns + right)

    def _of_channel(self, channel: int) -> str:
        size, disparity = float(self.magnifications[channel]), float(self.disparities[channel])
        offset = self.offsets[channel].tolist()
        parts = [f"{size:.5f} times the size"] if size != 1 else []
        parts += [f"({offset[0]:+.3f}, {offset[1]:+.3f}) px beside"] if any(offset) else []
        parts += [f"disparities {disparity:+.4f} px per view"] if disparity else []
        return f"channel {channel} has {', '.join(parts)}" if parts else ""


def find(evidence: Evidence) -> Chromatic:
    """Find how colours differ.

    Args:
        evidence: Of the light field.
    """
    n_channels = evidence.field.views.shape[2]
    if n_channels < 2:
        return _nothing(n_channels, "there is one channel")
    found = registered(evidence)
    if found is None:
        return _nothing(n_channels, "too little texture, or too few views, to tell")
    return _found(found)


def _found(found: Registration) -> Chromatic:
    first = dispersion.dispersions(found, found.seen)
    reach = float(found.places.abs().max())
    lateral = torch.tensor([_is_lateral(one.lateral) for one in first])
    axial = torch.tensor([_is_axial(one.axial, reach) for one in first])
    moved = torch.tensor([_is_beside(one.lateral) for one in first]) & lateral[:, None]
    sure = torch.cat([moved, lateral[:, None], axial[:, None]], 1)
    total = torch.where(sure, _values(first), 0.0)
    for _ in range(dispersion.ROUNDS if bool(sure.any()) else 0):
        seen = dispersion.read_again(found, total[:, :2], total[:, 2], total[:, 3])
        total = total + torch.where(sure, _values(dispersion.dispersions(found, seen)), 0.0)
    return Chromatic(1 + total[:, 2], total[:, :2], total[:, 3])


def _values(found: list[Dispersion]) -> Tensor:
    """Offset down and right, magnification less 1, disparity, [C, 4]."""
    return torch.stack([torch.cat([one.lateral.values, one.axial.values]) for one in found])


def _is_lateral(fit: Fitted) -> bool:
    is_sure = abs(float(fit.values[2])) > SURE * float(fit.errors[2])
    return is_sure and fit.effect > max(SHOWN, CLEAR["lateral"] * fit.scatter)


def _is_beside(fit: Fitted) -> list[bool]:
    return [
        abs(value) > max(LEAST_OFFSET, SURE * error)
        for value, error in zip(fit.values[:2].tolist(), fit.errors[:2].tolist(), strict=True)
    ]


def _is_axial(fit: Fitted, reach: float) -> bool:
    """Whether a disparity of its own shows in views as far as `reach` from the centre."""
    size = abs(float(fit.values[0]))
    is_sure = size > SURE * float(fit.errors[0])
    return is_sure and size * reach > SHOWN and size > CLEAR["axial"] * fit.scatter


def _nothing(n_channels: int, reason: str) -> Chromatic:
    nothing = torch.zeros(n_channels, 2, dtype=torch.float64)
    return Chromatic(1 + nothing[:, 0], nothing, nothing[:, 1].clone(), reason)


CHROMATIC = Correction(Chromatic, "textures that the colours share, in three views or more", find)
