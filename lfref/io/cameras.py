"""Where the cameras of a light field stood, if not on an even square grid.

A CSV file has a line a view under the header `row,column,v,u` or `view,v,u` (views row by row); a JSON file a list of
such records, or an array [V, U, 2]. v and u are positions along the rows and columns in any unit, in the direction in
which those count or against it: they are scaled so that the mean step between neighbouring views is 1.
"""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError, first_line
from lfref.io import atomic, grid, view_folders

EVEN = 1e-6
"""Positions nearer to the even grid, in view steps, are the even grid."""
EXAMPLE = "a line row,column,v,u or view,v,u for each view under such a header, or the like as JSON"


NAMES = "names"
"""Instead of a file: the names of the views."""


def of(
    path: Path,
    selection: grid.Selection,
    present: NDArray[np.bool_],
    positions: str | Path | None,
    spacing: tuple[float, float] | None,
) -> NDArray[np.float64] | None:
    """Where the cameras of a light field stood, as its reader is told.

    Args:
        path: The light field.
        selection: Which of its views are kept.
        present: Which of those there are, as stored, [V, U].
        positions: A file as `read` reads it, or `names`; None: on a grid.
        spacing: View steps from row to row and from column to column of that grid; None: 1 and 1.

    Returns:
        Positions (v, u) from the angular centre, in view steps, [V, U, 2]; None on an even square grid.

    Raises:
        FileError: The file is missing, or holds no positions.
        InputError: Both are given, or one that does not fit the light field.
    """
    if positions is not None and spacing is not None:
        got, remedy = "both", "leave out reader.positions or reader.spacing"
        raise InputError("cameras stand at positions, or in even steps", got=got, remedy=remedy)
    if spacing is not None:
        return _spaced(present.shape, spacing)
    if positions is None:
        return None
    if str(positions) == NAMES:
        return normalised(view_folders.positions(path, selection), present, f"the names in {path}")
    said, kept = read(positions), replace(selection, views=present.shape)
    rows, columns = kept.window(said.shape[:2], Path(positions))
    return normalised(said[rows, columns], present, str(positions))


def _spaced(shape: tuple[int, ...], spacing: Sequence[float]) -> NDArray[np.float64] | None:
    if len(spacing) != 2 or not all(math.isfinite(step) and step > 0 for step in spacing):
        got, remedy = list(spacing), "for example reader.spacing=[1,1.1]"
        raise InputError("spacing must be two steps above 0, of rows and of columns", got=got, remedy=remedy)
    return None if tuple(spacing) == (1, 1) else even(shape, spacing)


def read(path: str | Path) -> NDArray[np.float64]:
    """The positions in a CSV or JSON file.

    Args:
        path: The file.

    Returns:
        Positions (v, u) as they are written, NaN for views that are left out, [V, U, 2].

    Raises:
        FileError: The file is missing, or no such table.

    Example:
        >>> from lfref.io import atomic, cameras
        >>> atomic.write_text("rig.csv", "row,column,v,u\\n0,0,0,0\\n0,1,0,31\\n0,2,0,60\\n")
        >>> cameras.read("rig.csv")[0, :, 1].tolist()
        [0.0, 31.0, 60.0]
    """
    path = Path(path)
    with atomic.file_errors(path, "read"):
        contents = path.read_bytes()
    try:
        text = contents.decode("utf-8-sig")
        plain = json.loads(text) if text.lstrip()[:1] in ("[", "{") else _table(text)
        return _grid(plain)
    # Over a foreign file it is any of these, and what they say is told.
    except (ValueError, TypeError, KeyError, RecursionError, csv.Error) as error:
        got = f"no {error}" if isinstance(error, KeyError) else first_line(error)
        raise FileError(f"{path} must hold positions of cameras", got=got, remedy=f"write {EXAMPLE}") from error


def _table(text: str) -> list[dict[str, Any]]:
    return list(csv.DictReader(io.StringIO(text), skipinitialspace=True, strict=True))


def _grid(plain: Any) -> NDArray[np.float64]:
    """Positions by row and column of what a file holds: an array, or records."""
    if isinstance(plain, list) and plain and isinstance(plain[0], list):
        values = np.array(plain, dtype=np.float64)
        if values.ndim != 3 or values.shape[2] != 2 or 0 in values.shape:
            raise ValueError(f"an array of shape {list(values.shape)} for [V, U, 2]")
        return values
    if not (isinstance(plain, list) and plain and all(isinstance(record, dict) for record in plain)):
        raise ValueError("no views")
    records = [{str(key).strip(): value for key, value in record.items()} for record in plain]
    by_cell = {_cell(record): (float(record["v"]), float(record["u"])) for record in records}
    if len(by_cell) < len(records):
        raise ValueError("a view that is named twice")
    if not all(map(math.isfinite, sum(by_cell.values(), ()))):
        raise ValueError("a position that is not finite")
    return _by_row_and_column(by_cell) if "row" in records[0] else _row_major(by_cell)


def _cell(record: Mapping[str, Any]) -> tuple[int, int]:
    return (int(record["row"]), int(record["column"])) if "row" in record else (0, int(record["view"]))


def _by_row_and_column(by_cell: Mapping[tuple[int, int], tuple[float, float]]) -> NDArray[np.float64]:
    """Rows and columns in their order, from whatever number they begin."""
    rows, columns = (sorted(set(numbers)) for numbers in zip(*by_cell, strict=True))
    values = np.full((len(rows), len(columns), 2), np.nan)
    for (row, column), position in by_cell.items():
        values[rows.index(row), columns.index(column)] = position
    return values


def _row_major(by_cell: Mapping[tuple[int, int], tuple[float, float]]) -> NDArray[np.float64]:
    """Views of a square grid in their order, from whatever number they begin."""
    side = math.isqrt(len(by_cell))
    if side**2 != len(by_cell):
        raise ValueError(f"{len(by_cell)} views, which are no square number, without row and column")
    return np.array([by_cell[cell] for cell in sorted(by_cell)]).reshape(side, side, 2)


def normalised(said: NDArray[np.float64], present: NDArray[np.bool_], source: str) -> NDArray[np.float64] | None:
    """Positions in view steps from the angular centre.

    They are fitted by an even grid: the middle of it is the centre, its steps along rows and columns have the mean 1
    and their signs are turned so that positions grow with rows and columns.

    Args:
        said: Positions in any unit, NaN where they are not known, [V, U, 2].
        present: Which views there are, [V, U].
        source: Who says so, for messages.

    Returns:
        Positions (v, u); at missing views those of the even grid; [V, U, 2]. None if they are an even square grid.

    Raises:
        InputError: A view has no position, or positions that do not go along with rows and columns.
    """
    if np.isnan(said[present]).any():
        row, column = np.argwhere(present & np.isnan(said).any(axis=2))[0]
        raise InputError(f"{source} must say where each camera stood", got=f"none at row {row}, column {column}")
    offsets = even(said.shape[:2])
    steps, centre = _fit(said[present], offsets[present])
    _check_directions(steps, said.shape[:2], source)
    along = np.diagonal(steps)
    scale = np.mean(np.abs(along[along != 0])) if along.any() else 1.0
    values = (said - centre) * np.where(along < 0, -1, 1) / scale
    values = np.where(present[..., None], values, offsets)
    return None if np.allclose(values, offsets, rtol=0, atol=EVEN) else values


def even(shape: Sequence[int], spacing: Sequence[float] = (1.0, 1.0)) -> NDArray[np.float64]:
    """Positions on an even grid.

    Args:
        shape: Rows and columns of views.
        spacing: View steps from row to row and from column to column.

    Returns:
        Positions (v, u) from the angular centre, [V, U, 2].
    """
    rows, columns = ((np.arange(n) - (n - 1) / 2) * step for n, step in zip(shape, spacing, strict=True))
    return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)


def _fit(said: NDArray[np.float64], offsets: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Steps [along rows or columns, of v or u] and middle (v, u) of the even grid nearest to positions [N, 2].

    Each step is fitted on its own, which works on a diagonal too.
    """
    from_mean = offsets - offsets.mean(axis=0)
    squares = (from_mean**2).sum(axis=0)
    steps = np.divide(from_mean.T @ said, squares[:, None], out=np.zeros((2, 2)), where=squares[:, None] > 0)
    return steps, said.mean(axis=0) - np.diagonal(steps) * offsets.mean(axis=0)


def _check_directions(steps: NDArray[np.float64], shape: Sequence[int], source: str) -> None:
    """Refuse positions whose v does not go along with the rows, or whose u with the columns."""
    for axis, name in enumerate(("v and rows", "u and columns")):
        along, across = abs(steps[axis, axis]), abs(steps[1 - axis, axis])
        if shape[axis] > 1 and (along < across or along == 0):
            got = f"steps of {steps[0, axis]:g} along rows and {steps[1, axis]:g} along columns"
            raise InputError(f"{source} must let {name} grow together", got=got, remedy="exchange v and u in it")
