"""Positions of the cameras, where they do not stand on an even square grid.

A user gives them as a file, as the names of a Stanford gantry's views, or as the spacing of the grid. This module
converts them to the only form inside lfref: (v, u) of each camera in view steps from the angular centre, [V, U, 2].

A CSV file has a line per view below the header `row,column,v,u` or `view,v,u` (views row by row); a JSON file has a
list of such records, or an array [V, U, 2]. In files, v and u may have any unit and either direction: they are scaled
so that the mean step between neighbouring views is 1. This module stands apart from `read`, which needs it only for
uneven grids: it has file formats of its own.
"""

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError, first_line
from lfref.io import atomic, view_folders
from lfref.io.options import ReadOptions

EVEN = 1e-6
"""Largest distance from the even grid, in view steps, that counts as rounding."""
EXAMPLE = "a line row,column,v,u or view,v,u for each view under such a header, or the like as JSON"
NAMES = "names"
"""Value of the option `positions` that means the names of the views."""


def camera_positions(path: Path, options: ReadOptions, present: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Positions from the option `positions` or `spacing`; None for an even square grid.

    Args:
        path: The light field.
        options: Options of the reader; those that choose views count too.
        present: Which of the chosen views exist, as stored but transposed if `transpose` says so, [V, U].
    """
    if options.positions is None:
        spacing = options.spacing or (1, 1)
        return None if spacing == (1, 1) else even_positions(present.shape, spacing)
    if options.spacing is not None:
        got, remedy = "both", "leave out reader.positions or reader.spacing"
        raise InputError("cameras stand at positions, or in even steps", got=got, remedy=remedy)
    if options.positions == NAMES:
        chosen, source = view_folders.positions_in_names(path, options), f"the names in {path}"
    else:
        listed, source = read_positions(options.positions), options.positions
        shape = present.T.shape if options.transpose else present.shape
        chosen = listed[replace(options, views=shape).window(listed.shape[:2], Path(source))]
    return normalised(chosen.swapaxes(0, 1) if options.transpose else chosen, present, source)


def even_positions(shape: Sequence[int], spacing: Sequence[float] = (1.0, 1.0)) -> NDArray[np.float64]:
    """Positions (v, u) of the views of an even grid from its centre, in view steps, [V, U, 2]."""
    rows, columns = ((np.arange(n) - (n - 1) / 2) * step for n, step in zip(shape, spacing, strict=True))
    return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)


def read_positions(path: str | Path) -> NDArray[np.float64]:
    """The positions (v, u) in a CSV or JSON file as written, NaN for views that are left out, [V, U, 2].

    Example:
        >>> from lfref.io import atomic, cameras
        >>> atomic.write_text("rig.csv", "row,column,v,u\\n0,0,0,0\\n0,1,0,31\\n0,2,0,60\\n")
        >>> cameras.read_positions("rig.csv")[0, :, 1].tolist()
        [0.0, 31.0, 60.0]
    """
    path = Path(path)
    with atomic.file_errors(path, "read"):
        contents = path.read_bytes()
    try:
        text = contents.decode("utf-8-sig")
        if text.lstrip()[:1] in ("[", "{"):
            return _positions_of(json.loads(text))
        return _positions_of(list(csv.DictReader(io.StringIO(text), skipinitialspace=True, strict=True)))
    # A foreign file may raise any of these.
    except (ValueError, TypeError, KeyError, RecursionError, csv.Error) as error:
        got = f"no {error}" if isinstance(error, KeyError) else first_line(error)
        raise FileError(f"{path} must hold positions of cameras", got=got, remedy=f"write {EXAMPLE}") from error


def _positions_of(contents: Any) -> NDArray[np.float64]:
    """Positions by row and column from an array, or from a list of records."""
    if isinstance(contents, list) and contents and isinstance(contents[0], list):
        values = np.array(contents, dtype=np.float64)
        if values.ndim != 3 or values.shape[2] != 2 or 0 in values.shape:
            raise ValueError(f"an array of shape {list(values.shape)} for [V, U, 2]")
        return values
    if not (isinstance(contents, list) and contents and all(isinstance(record, dict) for record in contents)):
        raise ValueError("no views")
    by_cell: dict[tuple[int, int], tuple[float, float]] = {}
    for raw in contents:
        record = {str(key).strip(): value for key, value in raw.items()}
        cell = (int(record["row"]), int(record["column"])) if "row" in record else (0, int(record["view"]))
        if cell in by_cell:
            raise ValueError("a view that is named twice")
        by_cell[cell] = float(record["v"]), float(record["u"])
        if not all(map(math.isfinite, by_cell[cell])):
            raise ValueError("a position that is not finite")
    if "row" not in map(str.strip, map(str, contents[0])):
        side = math.isqrt(len(by_cell))
        if side**2 != len(by_cell):
            raise ValueError(f"{len(by_cell)} views, which are no square number, without row and column")
        return np.array([by_cell[cell] for cell in sorted(by_cell)]).reshape(side, side, 2)
    # Rows and columns may begin at any number.
    rows, columns = (sorted(set(numbers)) for numbers in zip(*by_cell, strict=True))
    values = np.full((len(rows), len(columns), 2), np.nan)
    for (row, column), position in by_cell.items():
        values[rows.index(row), columns.index(column)] = position
    return values


def normalised(listed: NDArray[np.float64], present: NDArray[np.bool_], source: str) -> NDArray[np.float64] | None:
    """Positions in view steps from the angular centre.

    The nearest even grid sets the centre (its middle is 0), the unit (its mean step is 1) and the signs (positions grow
    with rows and columns). Missing views get the positions of the even grid. The result is None if all are even.

    Args:
        listed: Positions in any unit, NaN where unknown, [V, U, 2].
        present: Which views exist, [V, U].
        source: Origin of the positions, for messages.
    """
    if np.isnan(listed[present]).any():
        row, column = np.argwhere(present & np.isnan(listed).any(axis=2))[0]
        raise InputError(f"{source} must say where each camera stood", got=f"none at row {row}, column {column}")
    offsets = even_positions(listed.shape[:2])
    # Least squares for each step alone also work for views on a diagonal: steps[along rows or columns, of v or u].
    from_mean = offsets[present] - offsets[present].mean(axis=0)
    squares = (from_mean**2).sum(axis=0)[:, None]
    steps = np.divide(from_mean.T @ listed[present], squares, out=np.zeros((2, 2)), where=squares > 0)
    for axis, name in enumerate(("v and rows", "u and columns")):
        along, across = abs(steps[axis, axis]), abs(steps[1 - axis, axis])
        if listed.shape[axis] > 1 and (along < across or along == 0):
            got = f"steps of {steps[0, axis]:g} along rows and {steps[1, axis]:g} along columns"
            raise InputError(
                f"{source} must let {name} grow together",
                got=got,
                remedy="give another reader.transpose (true or false), or exchange v and u in it",
            )
    step = np.diagonal(steps)
    centre = listed[present].mean(axis=0) - step * offsets[present].mean(axis=0)
    unit = np.mean(np.abs(step[step != 0])) if step.any() else 1.0
    values = (listed - centre) * np.where(step < 0, -1, 1) / unit
    values = np.where(present[..., None], values, offsets)
    return None if np.allclose(values, offsets, rtol=0, atol=EVEN) else values
