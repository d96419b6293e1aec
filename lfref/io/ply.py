"""Point clouds as PLY files, binary, little endian: what MeshLab, CloudCompare, Blender and Open3D read.

Source: Turk, "The PLY Polygon File Format", 1994.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import InputError
from lfref.io import atomic, marks

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
    marks.check_new(path)
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
    said = [f"comment {' '.join(line.split())}" for line in (f"written by {marks.SOFTWARE}", *comments)]
    properties = [f"property {TYPES[table.dtype[name].str[1:]]} {name}" for name in table.dtype.names or ()]
    lines = ["ply", "format binary_little_endian 1.0", *said, f"element vertex {len(table)}", *properties, "end_header"]
    return "\n".join(lines) + "\n"
