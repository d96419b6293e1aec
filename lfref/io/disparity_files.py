"""Maps of disparity as files: point clouds (PLY), and portable float maps (PFM).

Axes of a point cloud: x to the right, y upwards, z towards the viewer. The unit is the metre where the cameras are
known: a point at depth Z moves by `b f (1/Z - 1/F)` pixels between cameras at distance b that are focused on depth F,
with the focal length f in pixels. Else x and y are pixels from the centre of the picture, and z is the disparity at a
scale that shows relief. A PFM file is a text header (`Pf` grey or `PF` colour, width and height, a scale whose sign
tells the byte order), then rows of 32-bit floats from the bottom up.
Sources of the formats: Turk, "The PLY Polygon File Format", 1994; Debevec's description of PFM.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.io import atomic, images

RELIEF = 0.25
"""Growth of z per pixel of disparity where cameras are not known, as a share of the picture's shorter side."""
FARTHEST = 1e3
"""Largest depth of points, in focus distances: beyond it, disparity hardly depends on depth."""
METADATA = {"focal length": " mm", "sensor size": " mm", "baseline": " mm", "focus distance": " m"}
CUT = "cut from"
"""Entry of the metadata with the size of the pictures before they were cropped, such as `512x512 pixels`."""


@dataclass(frozen=True)
class Cameras:
    """Pinhole cameras in a plane, an equal step apart, all focused on (or cropped to) one depth."""

    focal_length: float
    """In longer sides of the picture."""
    baseline: float
    """Distance from one view to the next, in metres."""
    focus: float
    """Depth at which disparity is 0, in metres."""
    size: tuple[int, int] | None = None
    """Height and width of uncropped pictures (maps are their top left corner); None: size of the maps."""

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> "Cameras | None":
        """The cameras of a light field, as HCI describes them; None where an entry of `METADATA` is missing."""
        try:
            numbers = [float(metadata[name].removesuffix(unit)) for name, unit in METADATA.items()]
        except (KeyError, ValueError):
            return None
        if not all(0 < number < torch.inf for number in numbers):
            return None
        focal_length, sensor, baseline, focus = numbers
        whole = re.match(r"(\d+)x(\d+) ", metadata.get(CUT, ""))
        size = None if whole is None else (int(whole[1]), int(whole[2]))
        return cls(focal_length / sensor, baseline / 1000, focus, size)

    def focal_pixels(self, size: Sequence[int]) -> float:
        """Focal length in pixels of maps of a size [H, W]."""
        return self.focal_length * max(self.size or size)

    def dioptres(self, size: Sequence[int]) -> tuple[float, float]:
        """1 / depth in 1 / metres at disparity 0, and its growth per pixel of nearness, for maps of a size [H, W]."""
        return 1 / self.focus, 1 / (self.baseline * self.focal_pixels(size))


class Points(NamedTuple):
    """Points in space of some pixels of a map."""

    positions: Tensor
    """Coordinates x, y, z, float32, [P, 3], in reading order of the pixels."""
    pixels: Tensor
    """Pixels of the points, boolean, [H, W], P of them true."""
    unit: str


def points(nearness: Tensor, chosen: Tensor, cameras: Cameras | None = None) -> Points:
    """Put chosen pixels [H, W] of a map of nearness, disparity that grows towards us, into space up to `FARTHEST`."""
    near = nearness.double()
    pixels = chosen.bool() & near.isfinite()
    # The optical axis passes through the middle of uncropped pictures.
    height, width = (cameras and cameras.size) or near.shape
    rows, columns = (torch.arange(n, dtype=near.dtype, device=near.device) for n in near.shape)
    y = ((height - 1) / 2 - rows)[:, None].expand_as(near)
    x = (columns - (width - 1) / 2).expand_as(near)
    if cameras is None:
        scale = RELIEF * min(height, width)
        unit = f"unit: pixel; z is {scale:g} times the disparity, larger if nearer"
        return Points(torch.stack([x, y, scale * near], -1)[pixels].float(), pixels, unit)
    f, (at_zero, growth) = cameras.focal_pixels(near.shape), cameras.dioptres(near.shape)
    inverse = at_zero + growth * near
    pixels &= inverse * cameras.focus > 1 / FARTHEST
    depth = 1 / inverse
    return Points(torch.stack([x * depth / f, y * depth / f, -depth], -1)[pixels].float(), pixels, "unit: metre")


def write_points(
    path: str | Path,
    positions: NDArray,
    colours: NDArray[np.uint8],
    others: Mapping[str, NDArray] | None = None,
    comments: Sequence[str] = (),
) -> None:
    """Write points `x y z` [P, 3] with colours for the screen, uint8 [P, 3], as a binary PLY file.

    `others` are further properties by name, [P] each; `comments` are lines for the header.
    """
    # Colours come before properties that only some programs read.
    columns = {name: positions[:, k].astype("<f4") for k, name in enumerate("xyz")}
    columns |= {name: colours[:, k] for k, name in enumerate(("red", "green", "blue"))}
    columns |= {name: values.astype("<f4") for name, values in (others or {}).items()}
    kinds = {name: "uchar" if values.dtype == np.uint8 else "float" for name, values in columns.items()}
    lines = "written by lfref", *comments
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in lines)]
    header += [f"element vertex {len(positions)}", *(f"property {kind} {name}" for name, kind in kinds.items())]
    table = np.rec.fromarrays(list(columns.values()))
    with atomic.replacing(path) as partial, partial.open("wb") as file:
        file.write("\n".join([*header, "end_header\n"]).encode("ascii", "replace"))
        file.write(table.tobytes())


def write_pfm(path: str | Path, values: NDArray) -> None:
    """Write a PFM file: finite values, top row first, [H, W] or [H, W, C] with C 1 or 3."""
    samples = images.quantised(values, "float", Path(path))
    letter = b"F" if samples.ndim == 3 and samples.shape[2] == 3 else b"f"
    with atomic.replacing(path) as partial:
        first_lines = b"P%s\n%d %d\n-1.0\n" % (letter, samples.shape[1], samples.shape[0])
        partial.write_bytes(first_lines + samples[::-1].astype("<f4").tobytes())
