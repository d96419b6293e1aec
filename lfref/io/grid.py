"""The angular grid of stored views: which ones there are, which ones to keep, and filling an array with them.

A grid may have holes: what stands there has weight 0.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io.options import ALIGNED, Lenslets
from lfref.io.scratch import Room

Source = TypeVar("Source")
Cell = tuple[int, int]
"""Row and column of a view, from 0."""
LENSLET = 14
"""Views along each axis of the ESLF images of the Stanford archive."""
FEWEST_HOLES = 4
"""So many views at least are missing where that is on purpose."""


@dataclass(frozen=True)
class Selection:
    """Which views to read, and what their files look like."""

    views: tuple[int, int] | None = None
    """Rows and columns of views to keep; None keeps what the format keeps by default."""
    start: int | None = None
    """First row and column to keep; None keeps the centre (the upper of two equally central windows)."""
    pattern: str | None = None
    """Name of a pattern of file names, or a regular expression with groups `row` and `column`, or `index`."""
    lenslet: int = LENSLET
    """Views along each axis of an ESLF image."""
    grid: tuple[int, int] | None = None
    """Rows and columns of views that are numbered through; None: a square."""
    holes: bool | None = None
    """Whether views may be missing; None: only if they seem to be on purpose."""
    axes: str | None = None
    """What the axes of an array are; None: what its shape leaves no doubt about."""
    variable: str | None = None
    """Which array of a file of several; None: the only one that may be a light field."""
    lenslets: Lenslets = ALIGNED
    """What is said about the lenslets of an image that is not aligned with them."""
    encoding: str = "file"
    """How samples stand for light, for readers that must know it: as `encoding.parsed`, or `file`."""
    room: Room = np.zeros
    """Where views that are gathered lie."""

    def given(self) -> list[str]:
        """Names of the options that are not as they are by default, those of lenslets among them."""
        usual = Selection()
        own = [one.name for one in fields(self) if getattr(self, one.name) != getattr(usual, one.name)]
        return own + [one.name for one in fields(self.lenslets) if getattr(self.lenslets, one.name) is not None]

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


@dataclass(frozen=True)
class Grid(Generic[Source]):
    """Where each stored view is found; some of them may be missing."""

    shape: tuple[int, int]
    """Rows and columns of views."""
    cells: Mapping[Cell, Source]
    """What is stored at a row and column, from 0."""

    @property
    def n_holes(self) -> int:
        """How many views are missing."""
        return self.shape[0] * self.shape[1] - len(self.cells)


def extent(cells: Iterable[Cell]) -> tuple[int, int]:
    """Rows and columns of the smallest grid with these cells."""
    rows, columns = zip(*cells, strict=True)
    return 1 + max(rows), 1 + max(columns)


def check_holes(grid: Grid[Source], name_of: Callable[[Cell], str], path: Path, allowed: bool | None = None) -> None:
    """Refuse a grid whose views are missing by accident.

    Crosses, diagonals and grids without corners are made on purpose: they look the same upside down, which what is
    left of a broken copy hardly ever does.

    Args:
        grid: What is stored.
        name_of: Name that the view at a cell should have.
        path: File or folder, for messages.
        allowed: Whether views may be missing; None: only if they seem to be on purpose.

    Raises:
        FileError: A view is missing.
    """
    if not grid.n_holes or (_is_plausible(grid) and (allowed or (allowed is None and _is_on_purpose(grid)))):
        return
    # Not a list of all that are missing: a stray name may ask for billions.
    cell = next(cell for cell in _all_cells(grid.shape) if cell not in grid.cells)
    got = f"no {name_of(cell)} ({grid.n_holes} of {grid.shape[0] * grid.shape[1]} missing)"
    remedy = "add the missing views" + (", or set reader.holes=true" if allowed is None else "")
    raise FileError(f"{path} must hold a view for each row and column", got=got, remedy=remedy)


def _is_plausible(grid: Grid[Source]) -> bool:
    """Whether there are views enough for so large a grid; a stray name may ask for billions."""
    return max(grid.shape) <= 4 * len(grid.cells)


def _is_on_purpose(grid: Grid[Source]) -> bool:
    rows, columns = grid.shape
    turned = {(rows - 1 - row, columns - 1 - column) for row, column in grid.cells}
    return grid.n_holes >= FEWEST_HOLES and turned == set(grid.cells)


def _all_cells(grid: tuple[int, int]) -> Iterator[Cell]:
    return ((row, column) for row in range(grid[0]) for column in range(grid[1]))


def gather(
    grid: Grid[Source],
    window: tuple[slice, slice],
    load: Callable[[Source], NDArray],
    name_of: Callable[[Source], str],
    room: Room = np.zeros,
) -> NDArray:
    """The views of a window in one array.

    Args:
        grid: What is stored.
        window: Rows and columns to keep.
        load: Reads one view, [H, W, C].
        name_of: Name of a view, for messages.
        room: Where they shall lie.

    Returns:
        Samples in the type of the files, [V, U, C, H, W]. Where views of the window are missing, they hold the mean of
        those that are not, and the last channel is a weight that is 0 there.

    Raises:
        FileError: Two views differ in size, channels or type, or all of the window are missing.
    """
    chosen = list(_chosen(grid.cells, window))
    shape = window[0].stop - window[0].start, window[1].stop - window[1].start
    if not chosen:
        raise FileError(f"the {shape[0]}x{shape[1]} views to keep must be there", got="none", remedy="set reader.views")
    (_, first_source), first = chosen[0], load(chosen[0][1])
    has_holes = len(chosen) < shape[0] * shape[1]
    views = _with_weight(first, has_holes)
    gathered = room((*shape, *views.shape[2:], *views.shape[:2]), first.dtype)
    for (row, column), source in chosen:
        view = first if source is first_source else load(source)
        if _kind(view) != _kind(first):
            expected = f"{name_of(source)} must be {_kind(first)} as {name_of(first_source)}"
            raise FileError(expected, got=_kind(view), remedy="all views of a light field must be alike")
        gathered[row, column] = _with_weight(view, has_holes).transpose(2, 0, 1)
    if has_holes:
        _fill_holes(gathered, [cell for cell, _ in chosen])
    return gathered


def _with_weight(view: NDArray, wanted: bool) -> NDArray:
    """A view [H, W, C] with a weight as its last channel, if one is wanted and it has none."""
    if not wanted or view.shape[2] % 2 == 0:
        return view
    full = 1 if view.dtype.kind == "f" else np.iinfo(view.dtype).max
    return np.concatenate([view, np.full_like(view[..., :1], full)], axis=2)


def _fill_holes(views: NDArray, present: list[Cell]) -> None:
    """Put the mean of the views that are there where none is: weight 0 leaves it out, and nothing divides by it."""
    mean = np.mean([views[cell][:-1] for cell in present], axis=0, dtype=np.float64)
    if views.dtype.kind == "u":
        mean = np.rint(mean)
    for cell in set(_all_cells(views.shape[:2])) - set(present):
        views[cell][:-1] = mean


def _chosen(cells: Mapping[Cell, Source], window: tuple[slice, slice]) -> Iterator[tuple[Cell, Source]]:
    """Cells of the window in row-major order, counted from the corner of the window, but for those that are missing."""
    for row in range(window[0].start, window[0].stop):
        for column in range(window[1].start, window[1].stop):
            if (row, column) in cells:
                yield (row - window[0].start, column - window[1].start), cells[row, column]


def _kind(view: NDArray) -> str:
    height, width, n_channels = view.shape
    return f"{height}x{width}, {n_channels} channels, {view.dtype}"
