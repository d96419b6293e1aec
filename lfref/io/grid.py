"""The grid of stored views, for view folders and EXR files alike: which views exist, and one array of those to keep.

The holes of a grid are missing views; their weight is 0.
Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError

Source = TypeVar("Source")
Cell = tuple[int, int]
"""Row and column of a view, from 0."""
ROW_RATIO = 1.5
"""Difference of a view from the one below, over that from the next one, above which pictures count as one row."""
FEWEST_HOLES = 4
"""Fewest missing views that may be intended: the smallest such grids lack four corners, or four views of 3x3."""


@dataclass(frozen=True)
class Grid(Generic[Source]):
    """Stored views by row and column; some may be missing."""

    shape: tuple[int, int]
    """Rows and columns of views."""
    cells: Mapping[Cell, Source]
    """Row and column -> what is stored there, such as a path."""


def extent(cells: Iterable[Cell]) -> tuple[int, int]:
    """Rows and columns of the smallest grid with these cells."""
    rows, columns = zip(*cells, strict=True)
    return 1 + max(rows), 1 + max(columns)


def cell_of(number: int, n_columns: int, is_serpentine: bool = False) -> Cell:
    """The cell of a view by its number, row by row; on a serpentine path every second row runs to the left."""
    row, column = divmod(number, n_columns)
    return row, n_columns - 1 - column if is_serpentine and row % 2 else column


def check_holes(grid: Grid[Source], name_of: Callable[[Cell], str], path: Path, allowed: bool | None = None) -> None:
    """Refuse a grid whose views are missing by accident.

    Crosses, diagonals and grids without corners are intended: they are the same after half a turn, and an incomplete
    copy hardly ever is.

    Args:
        grid: The stored views.
        name_of: Name that the view at a cell should have.
        path: File or folder, for messages.
        allowed: Whether views may be missing; None: only if the holes seem intended.
    """
    rows, columns = grid.shape
    n_holes = rows * columns - len(grid.cells)
    # A stray file name may imply billions of views.
    is_plausible = max(grid.shape) <= 4 * len(grid.cells)
    upside_down = {(rows - 1 - row, columns - 1 - column) for row, column in grid.cells}
    is_on_purpose = n_holes >= FEWEST_HOLES and upside_down == set(grid.cells)
    if not n_holes or (is_plausible and (allowed or (allowed is None and is_on_purpose))):
        return
    cell = next((row, column) for row in range(rows) for column in range(columns) if (row, column) not in grid.cells)
    got = f"no {name_of(cell)} ({n_holes} of {rows * columns} missing)"
    remedy = "add the missing views" + (", or set reader.holes=true" if allowed is None else "")
    raise FileError(f"{path} must hold a view for each row and column", got=got, remedy=remedy)


def gather(
    grid: Grid[Source],
    window: tuple[slice, slice],
    load: Callable[[Source], NDArray],
    name_of: Callable[[Source], str],
) -> NDArray:
    """The views of a window in one array, in the type of the files, [V, U, C, H, W].

    If views are missing, the last channel is a weight: a missing view has weight 0, and holds the mean of the others.

    Args:
        grid: The stored views.
        window: Rows and columns to keep.
        load: Reads one view, [H, W, C].
        name_of: Name of a view, for messages.
    """
    shape = window[0].stop - window[0].start, window[1].stop - window[1].start
    present = {
        (row - window[0].start, column - window[1].start): grid.cells[row, column]
        for row in range(window[0].start, window[0].stop)
        for column in range(window[1].start, window[1].stop)
        if (row, column) in grid.cells
    }
    if not present:
        raise FileError(f"the {shape[0]}x{shape[1]} views to keep must be there", got="none", remedy="set reader.views")
    has_holes = len(present) < shape[0] * shape[1]
    first_source = next(iter(present.values()))
    first = load(first_source)
    adds_weight = has_holes and first.shape[2] % 2 == 1
    height, width, n_channels = first.shape
    gathered = np.zeros((*shape, n_channels + adds_weight, height, width), first.dtype)
    for cell, source in present.items():
        view = first if source is first_source else load(source)
        if (view.shape, view.dtype) != (first.shape, first.dtype):
            kinds = [f"{one.shape[0]}x{one.shape[1]}, {one.shape[2]} channels, {one.dtype}" for one in (first, view)]
            expected = f"{name_of(source)} must be {kinds[0]} as {name_of(first_source)}"
            raise FileError(expected, got=kinds[1], remedy="all views of a light field must be alike")
        gathered[cell][:n_channels] = view.transpose(2, 0, 1)
        if adds_weight:
            gathered[cell][-1] = 1 if view.dtype.kind == "f" else np.iinfo(view.dtype).max
    if has_holes:
        # Results exclude the mean by its weight 0; it only keeps black from divisions and from filters without weights.
        mean = np.mean([gathered[cell][:-1] for cell in present], axis=0, dtype=np.float64)
        for cell in np.ndindex(shape):
            if cell not in present:
                gathered[cell][:-1] = np.rint(mean) if gathered.dtype.kind == "u" else mean
    return gathered
