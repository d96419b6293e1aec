"""Folders of sub-aperture views: which file is the view at which row and column.

How names say it stands in `names`. Files that are only numbered through are taken for the views of a square grid, row
by row, where nothing speaks against it.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io import decode, explain, grid, images, names

SUFFIXES = [suffix for picture in decode.PICTURES.values() for suffix in picture.suffixes]
FEWEST_NUMBERED = 9
"""Pictures that are numbered through and are no views are rarely so many and a square number at once."""
ROW_RATIO = 1.5
"""How much more unlike a view the one below it must be than the next one, for pictures to be taken for one row."""
LARGEST_NUMBERED = 2500
"""Height and width, in pixels, from which numbered pictures may as well be lenslet images of several scenes."""


def image_files(folder: Path) -> list[Path]:
    """The image files of a folder, by suffix, hidden ones left out, sorted.

    Raises:
        FileError: The folder cannot be read.
    """
    with explain.explained(folder, "read"):
        files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    return sorted(path for path in files if not path.name.startswith("."))


def is_field(folder: Path) -> bool:
    """Whether a folder holds files that are named like sub-aperture views."""
    files = image_files(folder)
    return bool(names.known(files)) or any(_is_numbered_field(found) for found in names.numbered(files))


def is_view(path: Path) -> bool:
    """Whether a file is named like a view, beyond doubt, and has others beside it."""
    fields = names.known(image_files(path.parent))
    return any(len(found) > 1 and path in [one.path for one in found] for found in fields)


def read_views(folder: Path, selection: grid.Selection) -> NDArray:
    """The chosen views of a folder.

    Args:
        folder: The folder.
        selection: Views to keep (None: all) and the pattern of their names (None: one that `names` knows).

    Returns:
        Samples in the files' own type, alpha as the last channel, [V, U, C, H, W].

    Raises:
        FileError: The folder is empty or holds two light fields, a view is missing, damaged or unlike the others.
        InputError: The pattern is not usable, or the window of views leaves the grid.
    """
    stored = stored_grid(folder, selection)
    if selection.pattern is None and selection.grid is None:
        _check_square(folder, stored)
    return grid.gather(stored, selection.window(stored.shape, folder), images.read_image, str)


def stored_grid(folder: Path, selection: grid.Selection) -> grid.Grid[Path]:
    """Which file is the view at which row and column; arguments and errors as `read_views`."""
    found = _one_field(folder, selection.pattern)
    arrange = ARRANGEMENTS[names.numbering(found[0].match.re)]
    cells, shape, name_of = arrange(folder, found, selection)
    stored = grid.Grid(shape, {cell: one.path for cell, one in cells.items()})
    grid.check_holes(stored, name_of, folder, selection.holes)
    return stored


def _check_square(folder: Path, stored: grid.Grid[Path]) -> None:
    """Refuse a row of pictures, as of a moving camera, that was taken for a square grid because of their number.

    From the last view of a row to the first of the next it is a step in a row of pictures, and a long way in a grid;
    to the last of the next row it is the other way round.
    """
    n_rows, n_columns = stored.shape
    cells = (n_rows // 2 - 1, n_columns - 1), (n_rows // 2, 0), (n_rows // 2, n_columns - 1)
    paths = [stored.cells.get(cell) for cell in cells]
    if None in paths or not names.is_numbered(stored.cells.values()):
        return
    last, first_below, last_below = (images.read_image(path).astype(np.float32) for path in paths if path)
    if not last.shape == first_below.shape == last_below.shape:
        return  # which of them is unlike the others is said where all are read
    if np.abs(last_below - last).mean() > ROW_RATIO * np.abs(first_below - last).mean():
        got, n_views = f"{len(stored.cells)} pictures that look like one row", len(stored.cells)
        remedy = f"set reader.pattern=index and reader.grid=[1,{n_views}], or reader.grid=[{n_rows},{n_columns}]"
        raise FileError(f"{folder} must hold a square grid of views, row by row", got=got, remedy=remedy)


def positions(folder: Path, selection: grid.Selection) -> NDArray[np.float64]:
    """Where the names say that the cameras of the chosen views stood, as those of the Stanford gantry do.

    Args:
        folder: The folder.
        selection: As `read_views`.

    Returns:
        Positions along the rows and the columns in the names' own unit, NaN where a view is missing, [V, U, 2].

    Raises:
        FileError: As `read_views`, or the names say no positions.
    """
    if not folder.is_dir():
        remedy = "give a CSV or JSON file as reader.positions"
        raise FileError(f"{folder} must be a folder for positions=names", got="a file", remedy=remedy)
    found = {one.path: one.match.groupdict() for one in _one_field(folder, selection.pattern)}
    stored = stored_grid(folder, selection)
    said = np.full((*stored.shape, 2), np.nan)
    for cell, path in stored.cells.items():
        if "v" not in found[path] or "u" not in found[path]:
            remedy = "give a CSV or JSON file as reader.positions"
            raise FileError(f"{path} must be named out_RR_CC_Y_X for positions=names", got=path.name, remedy=remedy)
        said[cell] = float(found[path]["v"]), float(found[path]["u"])
    return said[selection.window(stored.shape, folder)]


def _one_field(folder: Path, pattern: str | None) -> list[names.Found]:
    """The files of the only light field in a folder."""
    files = image_files(folder)
    if not files:
        raise FileError(f"{folder} must hold images", got="none", remedy=f"put in {', '.join(SUFFIXES)} files")
    fields = _guessed(files) if pattern is None else names.following(files, [names.compiled(pattern)])
    if not fields:
        got = f"{len(files)} images named like {files[0].name}"
        remedy = "give reader.pattern: index (row by row), or a regular expression with groups row and column"
        raise FileError(f"{folder} must hold views whose names say their rows and columns", got=got, remedy=remedy)
    if len(fields) > 1:
        got = " and ".join(field[0].path.name for field in fields[:2])
        raise FileError(f"{folder} must hold one light field", got=got, remedy="move one away, or give reader.pattern")
    return fields[0]


def _guessed(files: list[Path]) -> list[list[names.Found]]:
    """The light fields whose names say where their views belong, else those that are numbered through."""
    return names.known(files) or [found for found in names.numbered(files) if _is_numbered_field(found)]


def _is_numbered_field(found: list[names.Found]) -> bool:
    """Whether numbered pictures may be taken for views without being asked: a square number of them, and small."""
    numbers = [one.numbers(("index",)) for one in found]
    if len(set(numbers)) < len(numbers):
        return False
    first, last = min(numbers)[0], max(numbers)[0]
    if _square(first, last, len(numbers)) is None or len(numbers) < FEWEST_NUMBERED:
        return False
    return min(decode.size(found[0].path)) < LARGEST_NUMBERED


def _square(first: int, last: int, count: int) -> tuple[int, int] | None:
    """Side and first number of a square grid whose views have numbers from 0 or 1, or from any number without holes.

    A grid with holes that is like itself turned upside down has its ends as far from its middle: first + last says
    the side, and whether numbers begin at 0 or at 1, since no two squares differ by 2.
    """
    side = math.isqrt(count)
    if side**2 == count == last - first + 1:
        return side, first
    for base in (0, 1):
        side = math.isqrt(max(0, first + last - 2 * base) + 1)
        if side**2 - 1 == first + last - 2 * base and count < side**2:
            return side, base
    return None


class Arrangement(NamedTuple):
    """Where the files of a light field belong."""

    cells: dict[grid.Cell, names.Found]
    """File at each row and column from 0."""
    shape: tuple[int, int]
    """Rows and columns of the grid, of which some may be missing."""
    name_of: Callable[[grid.Cell], str]
    """What the file at a row and column would be called."""


def _by_row_and_column(folder: Path, found: list[names.Found], selection: grid.Selection) -> Arrangement:
    """Views at their rows and columns, counted from the smallest, in steps of what all of them have in common."""
    numbered = names.by_numbers(found, ("row", "column"))
    if selection.pattern is None:
        _check_row(folder, found)
    top, left = min(row for row, _ in numbered), min(column for _, column in numbered)
    step = math.gcd(*(number for row, column in numbered for number in (row - top, column - left))) or 1
    cells = {((row - top) // step, (column - left) // step): one for (row, column), one in numbered.items()}

    def name_of(cell: grid.Cell) -> str:
        return found[0].renamed({"row": top + step * cell[0], "column": left + step * cell[1]})

    return Arrangement(cells, grid.extent(cells), name_of)


def _check_row(folder: Path, found: list[names.Found]) -> None:
    """Refuse a single row of a square number of views unless its numbers are as wide as each other.

    `cam_1_01` to `cam_1_81` may be a row of 81 views, or a camera's 9x9 numbered through.
    """
    is_row = len({one.match["row"] for one in found}) == 1
    is_even = all(len(one.match["row"]) == len(one.match["column"]) for one in found)
    if is_row and not is_even and math.isqrt(len(found)) ** 2 == len(found) > 1:
        got = f"{len(found)} views named like {found[0].path.name}"
        remedy = "give reader.pattern=index for a square grid row by row, or reader.pattern=row_column for one row"
        raise FileError(f"{folder} must say its rows and columns", got=got, remedy=remedy)


def _row_major(folder: Path, found: list[names.Found], selection: grid.Selection) -> Arrangement:
    """Views that are numbered through row by row, of a square grid unless another is asked for."""
    numbered = names.by_numbers(found, ("index",))
    shape, base = _square_or_asked(folder, found, [index for (index,) in numbered], selection.grid)
    cells = {divmod(index - base, shape[1]): one for (index,), one in numbered.items()}
    return Arrangement(cells, shape, lambda cell: found[0].renamed({"index": base + shape[1] * cell[0] + cell[1]}))


def _square_or_asked(
    folder: Path, found: list[names.Found], numbers: list[int], asked: tuple[int, int] | None
) -> tuple[tuple[int, int], int]:
    """Rows and columns of a grid that is numbered through, and its first number."""
    first, last, count = min(numbers), max(numbers), len(numbers)
    if asked is not None:
        n_views = asked[0] * asked[1]
        base = first if last - first + 1 == n_views else min(first, 1)
        if min(asked) < 1 or last - base >= n_views:
            got, remedy = f"{count} views numbered {first} to {last}", "set reader.grid to fit"
            raise InputError(f"{folder} must hold {asked[0]}x{asked[1]} views", got=got, remedy=remedy)
        return asked, base
    if square := _square(first, last, count):
        return (square[0], square[0]), square[1]
    side = math.isqrt(last - first) + 1
    absent = next(index for index in range(first, first + side**2) if index not in set(numbers))
    expected = f"{folder} must hold a square number of views, {side}x{side} for numbers up to {last}"
    got = f"{count}, no {found[0].renamed({'index': absent})}"
    raise FileError(expected, got=got, remedy="add the missing views, or give reader.grid=[rows,columns]")


ARRANGEMENTS: dict[tuple[str, ...], Callable[[Path, list[names.Found], grid.Selection], Arrangement]] = {
    ("row", "column"): _by_row_and_column,
    ("index",): _row_major,
}
