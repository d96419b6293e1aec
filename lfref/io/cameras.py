"""Positions of cameras off an even square grid: (v, u) in view steps from the angular centre, [V, U, 2].

A user gives them as a CSV file, as the names of a Stanford gantry's views, or as the spacing of the grid. The file has
a line per view below the header `row,column,v,u`, where v and u may have any unit and either direction.
"""

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError, first_line
from lfref.io import atomic, view_folders
from lfref.io.samples import ReadOptions

EVEN = 1e-6
"""Largest distance from the even grid, in view steps, that counts as rounding."""
NAMES = "names"
"""Value of the option `positions` that means the names of the views."""


def camera_positions(path: Path, options: ReadOptions, present: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Positions by the options; None for an even square grid. `present` says which views exist, after `transpose`."""
    if options.positions is None:
        spacing = options.spacing or (1, 1)
        return None if spacing == (1, 1) else even_positions(present.shape, spacing)
    if options.positions == NAMES:
        chosen, source = view_folders.positions_in_names(path, options), f"the names in {path}"
    else:
        listed, source = read_positions(options.positions), str(options.positions)
        shape = present.T.shape if options.transpose else present.shape
        chosen = listed[replace(options, angular_size=shape).window(listed.shape[:2], Path(source))]
    return normalised(chosen.swapaxes(0, 1) if options.transpose else chosen, present, source)


def even_positions(shape: Sequence[int], spacing: Sequence[float] = (1.0, 1.0)) -> NDArray[np.float64]:
    """Positions (v, u) of the views of an even grid from its centre, in view steps, [V, U, 2]."""
    rows, columns = ((np.arange(n) - (n - 1) / 2) * step for n, step in zip(shape, spacing, strict=True))
    return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)


def read_positions(path: str | Path) -> NDArray[np.float64]:
    """The positions (v, u) in a CSV file as written, NaN for views that are left out, [V, U, 2].

    Rows and columns may begin at any number.
    """
    path = Path(path)
    try:
        with atomic.file_errors(path, "read"), path.open(encoding="utf-8-sig", newline="") as file:
            table = list(csv.DictReader(file, skipinitialspace=True))
        cells = [(int(record["row"]), int(record["column"])) for record in table]
        rows, columns = (sorted(set(numbers)) for numbers in zip(*cells, strict=True))
        positions = np.full((len(rows), len(columns), 2), np.nan)
        for (row, column), record in zip(cells, table, strict=True):
            positions[rows.index(row), columns.index(column)] = float(record["v"]), float(record["u"])
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        got = f"no {error}" if isinstance(error, KeyError) else first_line(error)
        remedy = "write a line row,column,v,u for each view under such a header"
        raise FileError(f"{path} must hold positions of cameras", got=got, remedy=remedy) from error
    return positions


def normalised(listed: NDArray[np.float64], present: NDArray[np.bool_], source: str) -> NDArray[np.float64] | None:
    """Positions in view steps from the angular centre, of those in any unit; None if they are even.

    The nearest even grid sets the centre (its middle is 0), the unit (its mean step is 1) and the signs (positions grow
    with rows and columns). Missing views get the positions of the even grid.
    """
    if not np.isfinite(listed[present]).all():
        row, column = np.argwhere(present & ~np.isfinite(listed).all(axis=2))[0]
        raise InputError(f"{source} must say where each camera stood", got=f"none at row {row}, column {column}")
    offsets = even_positions(listed.shape[:2])
    # Least squares for each step alone also work for views on a diagonal: steps[along rows or columns, of v or u].
    from_mean = offsets[present] - offsets[present].mean(axis=0)
    squares = (from_mean**2).sum(axis=0)[:, None]
    steps = np.divide(from_mean.T @ listed[present], squares, out=np.zeros((2, 2)), where=squares > 0)
    step = np.diagonal(steps)
    is_along = (abs(step) >= abs(np.diagonal(steps[::-1]))) & (step != 0)
    if not all(is_along[axis] or listed.shape[axis] == 1 for axis in (0, 1)):
        got, remedy = f"steps {steps.tolist()}", "set reader.transpose=true (or false), or exchange v and u in it"
        raise InputError(f"{source} must let v grow with rows, and u with columns", got=got, remedy=remedy)
    centre = listed[present].mean(axis=0) - step * offsets[present].mean(axis=0)
    unit = np.mean(np.abs(step[step != 0])) if step.any() else 1.0
    values = (listed - centre) * np.where(step < 0, -1, 1) / unit
    values = np.where(present[..., None], values, offsets)
    return None if np.allclose(values, offsets, rtol=0, atol=EVEN) else values
