"""Point clouds as PLY files, binary, little endian: what MeshLab, CloudCompare, Blender and Open3D read.

Source: Turk, "The PLY Polygon File Format", 1994.
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

from lfref.errors import InputError
from lfref.io import atomic, ownership

# PART point_cloud
# From a map of disparity to points in space: x to the right, y upwards, z towards the viewer.
#
# In metres where the cameras are known: a point at depth Z from cameras b apart that are focused on depth F moves by
# `b f (1/Z - 1/F)` pixels from one to the next, f being the focal length in pixels. Else x and y are pixels from the
# centre of the picture, and z is the disparity at a scale that shows relief.

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


TYPES = {"f4": "float", "u1": "uchar"}
"""Sample type in numpy -> in a PLY header."""


def write_points(
    path: str | Path,
    places: NDArray,
    colours: NDArray[np.uint8],
    others: Mapping[str, NDArray] | None = None,
    comments: Sequence[str] = (),
) -> None:
    """Write a point cloud: `x y z`, `red green blue`, and whatever else is known of each point.

    Args:
        path: The `.ply` file to write, which must not exist; folders above it are made.
        places: Where the points are, finite, [P, 3].
        colours: As they are shown, RGB, uint8, [P, 3].
        others: Further properties, each by a name of one word, [P].
        comments: Lines for the header: units, and what the numbers mean.

    Raises:
        InputError: Points that are not finite, properties that do not fit them, or another suffix.
        FileError: The disk refuses, or there is such a file.

    Example:
        >>> write_points("corner.ply", np.zeros((1, 3)), np.zeros((1, 3), np.uint8), comments=["unit: metre"])
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise InputError(f"{path} must end in .ply", remedy="choose another suffix")
    columns = {name: places[:, axis] for axis, name in enumerate("xyz")} | dict(others or {})
    _check(path, columns, len(places), colours)
    table = np.empty(len(places), [(name, "<f4") for name in "xyz"] + _fields(others or {}))
    for name, values in columns.items():
        table[name] = values
    for channel, name in enumerate(COLOURS):
        table[name] = colours[:, channel]
    ownership.check_new(path)
    with atomic.replacing(path) as partial, partial.open("wb") as file:
        file.write(_header(table, comments).encode("ascii", "replace"))
        file.write(table.tobytes())


COLOURS = ("red", "green", "blue")


def _fields(others: Mapping[str, NDArray]) -> list[tuple[str, str]]:
    """Colours stand before what only some programs look at."""
    return [(name, "u1") for name in COLOURS] + [(name, "<f4") for name in others]


def _check(path: Path, columns: Mapping[str, NDArray], n_points: int, colours: NDArray) -> None:
    if colours.shape != (n_points, 3) or any(values.shape != (n_points,) for values in columns.values()):
        raise InputError(f"points of {path} must have three coordinates, three colours, and one value of each kind")
    if not all(np.isfinite(values).all() for values in columns.values()):
        raise InputError(f"values for {path} must be finite", got="NaN or infinity", remedy="leave such points out")


def _header(table: NDArray, comments: Sequence[str]) -> str:
    said = [f"comment {' '.join(line.split())}" for line in (f"written by {ownership.SOFTWARE}", *comments)]
    properties = [f"property {TYPES[table.dtype[name].str[1:]]} {name}" for name in table.dtype.names or ()]
    lines = ["ply", "format binary_little_endian 1.0", *said, f"element vertex {len(table)}", *properties, "end_header"]
    return "\n".join(lines) + "\n"
