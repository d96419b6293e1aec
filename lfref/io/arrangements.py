"""From the names of views to their rows and columns: numbers of rows and columns, or places in row-major order."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from lfref.errors import FileError, InputError
from lfref.io import grid, names


class Arrangement(NamedTuple):
    """Where the files of a light field belong."""

    cells: dict[grid.Cell, names.Found]
    """File at each row and column from 0."""
    shape: tuple[int, int]
    """Rows and columns of the grid, of which some may be missing."""
    name_of: Callable[[grid.Cell], str]
    """What the file at a row and column would be called."""


def of(folder: Path, found: list[names.Found], selection: grid.Selection) -> Arrangement:
    """Where the files of a light field belong.

    Args:
        folder: Of the files, for messages.
        found: The files, all of one pattern.
        selection: Whether the pattern was asked for, and the grid.

    Raises:
        FileError: Two files are the same view, or names leave open where views belong.
        InputError: Names that hold no numbers, or a grid that does not fit.
    """
    return ARRANGEMENTS[names.numbering(found[0].match.re)](folder, found, selection)


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
        return (asked[0], asked[1]), base
    if found_square := square(first, last, count):
        side, base = found_square
        return (side, side), base
    side = math.isqrt(last - first) + 1
    present = set(numbers)
    absent = next(index for index in range(first, first + side**2) if index not in present)
    expected = f"{folder} must hold a square number of views, {side}x{side} for numbers up to {last}"
    got = f"{count}, no {found[0].renamed({'index': absent})}"
    raise FileError(expected, got=got, remedy="add the missing views, or give reader.grid=[rows,columns]")


ARRANGEMENTS: dict[tuple[str, ...], Callable[[Path, list[names.Found], grid.Selection], Arrangement]] = {
    ("row", "column"): _by_row_and_column,
    ("index",): _row_major,
}


def square(first: int, last: int, count: int) -> tuple[int, int] | None:
    """The square grid that views make which are numbered through from 0 or 1, or from any number without holes.

    A grid with holes that is like itself turned upside down has its ends as far from its middle: first + last says
    the side, and whether numbers begin at 0 or at 1, since no two squares differ by 2.

    Args:
        first: Smallest number.
        last: Largest number.
        count: How many views there are.

    Returns:
        Rows (or columns), and the number of the first view; None: no such grid.
    """
    side = math.isqrt(count)
    if side**2 == count == last - first + 1:
        return side, first
    for base in (0, 1):
        side = math.isqrt(max(0, first + last - 2 * base) + 1)
        if side**2 - 1 == first + last - 2 * base and count < side**2:
            return side, base
    return None
