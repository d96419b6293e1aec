"""The angular grid of stored views: which ones there are, which ones to keep, and filling an array with them.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io.lenslets.options import ALIGNED, Lenslets

Source = TypeVar("Source")
Cell = tuple[int, int]
"""Row and column of a view, from 0."""


@dataclass(frozen=True)
class Selection:
    """Which views to read, and what their files look like."""

    views: tuple[int, int] | None = None
    """Rows and columns of views to keep; None keeps what the format keeps by default."""
    start: int | None = None
    """First row and column to keep; None keeps the centre (the upper of two equally central windows)."""
    pattern: str | None = None
    """Regular expression for the file names of a folder, with groups `row` and `column`, or `index`."""
    lenslet: int = 14
    """Views along each axis of an ESLF image."""
    lenslets: Lenslets = ALIGNED
    """What is said about the lenslets of an image that is not aligned with them."""
    encoding: str = "file"
    """How samples stand for light, for readers that must know it: as `encoding.parsed`, or `file`."""

    def window(self, grid: tuple[int, int], path: Path) -> tuple[slice, slice]:
        """Rows and columns of views to keep.

        Args:
            grid: Rows and columns of views that there are.
            path: File or folder, for messages.

        Raises:
            InputError: The window is empty or leaves the grid.
        """
        rows, columns = grid if self.views is None else self.views
        return self._along(grid[0], rows, path), self._along(grid[1], columns, path)

    def _along(self, n_views: int, count: int, path: Path) -> slice:
        # Rounded up, so that 7 of 14 are views 4 to 10, whose centre 7 is the usual reference view.
        first = (n_views - count + 1) // 2 if self.start is None else self.start
        if count < 1 or first < 0 or first + count > n_views:
            got = f"views {count}, start {'in the middle' if self.start is None else first}"
            remedy = "choose views and start to fit (reader.views and reader.start of a command)"
            raise InputError(f"views to keep must be among the {n_views} of {path}", got=got, remedy=remedy)
        return slice(first, first + count)


def shape(cells: Mapping[Cell, Source], name_of: Callable[[Cell], str], path: Path) -> tuple[int, int]:
    """Rows and columns of a grid that must have no hole.

    Args:
        cells: What is stored at each row and column, from 0.
        name_of: Name that the view at a cell should have.
        path: File or folder, for messages.

    Raises:
        FileError: A view is missing.
    """
    grid = 1 + max(row for row, _ in cells), 1 + max(column for _, column in cells)
    n_views = grid[0] * grid[1]
    if len(cells) < n_views:
        # Not a list of all that are missing: a stray name may ask for billions.
        row, column = next(cell for cell in _all_cells(grid) if cell not in cells)
        got = f"no {name_of((row, column))} ({n_views - len(cells)} of {n_views} missing)"
        raise FileError(f"{path} must hold a view for each row and column", got=got, remedy="add the missing views")
    return grid


def _all_cells(grid: tuple[int, int]) -> Iterator[Cell]:
    return ((row, column) for row in range(grid[0]) for column in range(grid[1]))


def gather(
    cells: Mapping[Cell, Source],
    window: tuple[slice, slice],
    load: Callable[[Source], NDArray],
    name_of: Callable[[Source], str],
) -> NDArray:
    """The views of a window in one array.

    Args:
        cells: What is stored at each row and column, from 0.
        window: Rows and columns to keep.
        load: Reads one view, [H, W, C].
        name_of: Name of a view, for messages.

    Returns:
        Samples in the type of the files, [V, U, C, H, W].

    Raises:
        FileError: Two views differ in size, channels or type.
    """
    chosen = list(_chosen(cells, window))
    first = load(chosen[0][1])
    views = np.empty((window[0].stop - window[0].start, window[1].stop - window[1].start, *_chw(first)), first.dtype)
    for (row, column), source in chosen:
        view = load(source) if row or column else first
        if _kind(view) != _kind(first):
            expected = f"{name_of(source)} must be {_kind(first)} as {name_of(chosen[0][1])}"
            raise FileError(expected, got=_kind(view), remedy="all views of a light field must be alike")
        views[row, column] = view.transpose(2, 0, 1)
    return views


def _chosen(cells: Mapping[Cell, Source], window: tuple[slice, slice]) -> Iterator[tuple[Cell, Source]]:
    """Cells of the window in row-major order, counted from the corner of the window."""
    for row in range(window[0].start, window[0].stop):
        for column in range(window[1].start, window[1].stop):
            yield (row - window[0].start, column - window[1].start), cells[row, column]


def _chw(view: NDArray) -> tuple[int, int, int]:
    height, width, n_channels = view.shape
    return n_channels, height, width


def _kind(view: NDArray) -> str:
    height, width, n_channels = view.shape
    return f"{height}x{width}, {n_channels} channels, {view.dtype}"
