"""From a map of disparity to points in space: x to the right, y upwards, z towards the viewer.

In metres where the cameras are known: a point at depth Z from cameras b apart that are focused on depth F moves by
`b f (1/Z - 1/F)` pixels from one to the next, f being the focal length in pixels. Else x and y are pixels from the
centre of the picture, and z is the disparity at a scale that shows relief.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError

RELIEF = 0.25
"""Of the shorter side of the picture: what z grows by for a pixel of disparity, where cameras are not known."""
FARTHEST = 1e3
"""In distances of the focus: what is farther has hardly any disparity, and would stand anywhere."""


@dataclass(frozen=True)
class Cameras:
    """Pinholes in a plane, an equal step apart, all focused on (or cropped to) one depth."""

    focal_length: float
    """In shares of the longer side of the picture."""
    baseline: float
    """From one view to the next, in metres."""
    focus: float
    """Depth without disparity, in metres."""
    size: tuple[int, int] | None = None
    """Height and width in pixels of the pictures whose top left corner the maps are; None: that of the maps."""

    @classmethod
    def said_by(cls, metadata: Mapping[str, str]) -> "Cameras | None":
        """The cameras of a light field, None where it does not say all that is needed.

        Args:
            metadata: Of the light field; the entries of `METADATA` count, which HCI light fields have, and `CUT`.
        """
        try:
            focal, sensor, baseline, focus = (
                float(metadata[name].removesuffix(unit)) for name, unit in METADATA.items()
            )
        except (KeyError, ValueError):
            return None
        if not all(0 < number < torch.inf for number in (focal, sensor, baseline, focus)):
            return None
        return cls(focal / sensor, baseline / 1000, focus, _whole(metadata.get(CUT, "")))


CUT = "cut from"
"""Entry of the metadata that says the size of pictures of which only a corner was kept, as `512x512 pixels`."""
METADATA = {"focal length": " mm", "sensor size": " mm", "baseline": " mm", "focus distance": " m"}
"""Entry of the metadata -> its unit."""


def _whole(said: str) -> tuple[int, int] | None:
    found = re.match(r"(\d+)x(\d+) ", said)
    return None if found is None else (int(found[1]), int(found[2]))


class Points(NamedTuple):
    """Where the pixels of a map are in space."""

    places: Tensor
    """x, y, z, float32, [P, 3]."""
    pixels: Tensor
    """Which pixels they are, [H, W], P of them true; the points stand in reading order."""
    unit: str
    """What the numbers are, in one line."""


def points(nearness: Tensor, chosen: Tensor, cameras: Cameras | None = None) -> Points:
    """Put pixels into space.

    Args:
        nearness: Disparity in pixels per view step with the sign by which larger is nearer, [H, W].
        chosen: Which pixels to put, [H, W], boolean; those that are not finite, or beyond `FARTHEST`, are left out.
        cameras: Who saw it; None if nobody knows.

    Returns:
        The points.

    Raises:
        InputError: They are no maps of one size.
    """
    if nearness.ndim != 2 or nearness.shape != chosen.shape:
        raise InputError("nearness and chosen must be [H, W]", got=f"{list(nearness.shape)}, {list(chosen.shape)}")
    near = nearness.double()
    pixels = chosen.bool() & near.isfinite()
    # Cameras look straight ahead in the middle of whole pictures.
    height, width = (cameras and cameras.size) or near.shape
    rows, columns = (torch.arange(n, dtype=near.dtype, device=near.device) for n in near.shape)
    y = ((height - 1) / 2 - rows)[:, None].expand_as(near)
    x = (columns - (width - 1) / 2).expand_as(near)
    if cameras is None:
        scale = RELIEF * min(height, width)
        unit = f"unit: pixel; z is {scale:g} times the nearness (disparity with the sign by which larger is nearer)"
        return Points(torch.stack([x, y, scale * near], -1)[pixels].float(), pixels, unit)
    f = cameras.focal_length * max(height, width)
    inverse = 1 / cameras.focus + near / (cameras.baseline * f)
    pixels &= inverse * cameras.focus > 1 / FARTHEST
    depth = 1 / inverse
    return Points(torch.stack([x * depth / f, y * depth / f, -depth], -1)[pixels].float(), pixels, "unit: metre")
