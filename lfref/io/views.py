"""Folders of sub-aperture views: which file is the view at which row and column.

Known names are those of the HCI benchmark (`input_Cam000.png`, row-major, square), `NAME_RR_CC.png` (also what
`lfref.write` makes; from 0 or 1) and the Stanford gantry (`out_RR_CC_X_Y.png`); others need a pattern.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io import decode, explain, grid, images

SUFFIXES = [suffix for picture in decode.PICTURES.values() for suffix in picture.suffixes]
PATTERNS: dict[str, str] = {
    "Stanford gantry": r"^(?P<name>out)_(?P<row>\d+)_(?P<column>\d+)_-?\d+\.\d+_-?\d+\.\d+_?\.\w+$",
    "HCI": r"^(?P<name>input_Cam)(?P<index>\d+)\.\w+$",
    "NAME_RR_CC": r"^(?P<name>.+)_(?P<row>\d+)_(?P<column>\d+)\.\w+$",
}


class Found(NamedTuple):
    """A file that follows a pattern."""

    path: Path
    match: re.Match[str]

    def numbers(self, groups: Iterable[str]) -> tuple[int, ...]:
        """What the name says its row and column, or its index, are."""
        return tuple(int(self.match[group]) for group in groups)

    def renamed(self, numbers: Mapping[str, int]) -> str:
        """The name that the file would have with other numbers."""
        name = self.match.string
        for group in sorted(numbers, key=self.match.start, reverse=True):
            first, last = self.match.span(group)
            name = f"{name[:first]}{numbers[group]:0{last - first}d}{name[last:]}"
        return name


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
    return any(_following(image_files(folder), regex) for regex in PATTERNS.values())


def is_view(path: Path) -> bool:
    """Whether a file is named like a view and has others beside it."""
    siblings = [_following(image_files(path.parent), regex) for regex in PATTERNS.values()]
    return any(len(found) > 1 and path in [one.path for one in found] for found in siblings)


def read_views(folder: Path, selection: grid.Selection) -> NDArray:
    """The chosen views of a folder.

    Args:
        folder: The folder.
        selection: Views to keep (None: all) and the pattern of their names (None: one of `PATTERNS`).

    Returns:
        Samples in the files' own type, alpha as the last channel, [V, U, C, H, W].

    Raises:
        FileError: The folder is empty or holds two light fields, a view is missing, damaged or unlike the others.
        InputError: The pattern is not usable, or the window of views leaves the grid.
    """
    found = _one_field(folder, selection.pattern)
    arrange = ARRANGEMENTS[_numbering(found[0].match.re)]
    cells = arrange(folder, found)
    missing_name = _namer(found[0], cells)
    window = selection.window(grid.shape(cells, missing_name, folder), folder)
    return grid.gather(cells, window, images.read_image, str)


def _following(files: Iterable[Path], regex: str | re.Pattern[str]) -> list[Found]:
    matches = ((path, re.search(regex, path.name)) for path in files)
    return [Found(path, match) for path, match in matches if match]


def _compiled(pattern: str) -> re.Pattern[str]:
    """A user's pattern, once it is known to be usable."""
    try:
        regex = re.compile(pattern)
    except re.error as error:
        raise InputError("pattern must be a regular expression", got=f"{pattern!r} ({error})") from error
    if _numbering(regex) not in ARRANGEMENTS:
        raise InputError("pattern must have the named groups row and column, or index", got=repr(pattern))
    return regex


def _numbering(regex: re.Pattern[str]) -> tuple[str, ...]:
    """Which groups of a pattern say where a view belongs."""
    return tuple(group for group in ("row", "column", "index") if group in regex.groupindex)


def _one_field(folder: Path, pattern: str | None) -> list[Found]:
    """The files of the only light field in a folder."""
    files = image_files(folder)
    if not files:
        raise FileError(f"{folder} must hold images", got="none", remedy=f"put in {', '.join(SUFFIXES)} files")
    regexes = [re.compile(known) for known in PATTERNS.values()] if pattern is None else [_compiled(pattern)]
    fields = _split_by_name(found for regex in regexes for found in _following(files, regex))
    if not fields:
        got = f"names like {files[0].name}"
        remedy = "give pattern, a regular expression with groups row and column, or index"
        raise FileError(f"{folder} must hold views named like {' or '.join(PATTERNS)}", got=got, remedy=remedy)
    if len(fields) > 1:
        got = " and ".join(field[0].path.name for field in fields[:2])
        raise FileError(f"{folder} must hold one light field", got=got, remedy="move one away, or give pattern")
    return fields[0]


def _split_by_name(matches: Iterable[Found]) -> list[list[Found]]:
    """The files of each pattern and each name."""
    fields: dict[tuple[str, str], list[Found]] = {}
    for found in matches:
        key = found.match.re.pattern, found.match.groupdict().get("name") or ""
        fields.setdefault(key, []).append(found)
    return list(fields.values())


def _by_numbers(found: list[Found], groups: tuple[str, ...]) -> dict[tuple[int, ...], Found]:
    """Numbers in the name -> file, each only once."""
    numbered: dict[tuple[int, ...], Found] = {}
    for one in found:
        try:
            numbers = one.numbers(groups)
        except (TypeError, ValueError) as error:
            raise InputError(f"groups of pattern must be numbers in {one.path}", got=error) from error
        if numbers in numbered:
            got = f"{numbered[numbers].path.name} and {one.path.name}"
            raise FileError(f"{one.path.parent} must hold each view once", got=got, remedy="remove one of them")
        numbered[numbers] = one
    return numbered


def _by_row_and_column(folder: Path, found: list[Found]) -> dict[grid.Cell, Path]:
    """Views at their rows and columns, counted from the smallest."""
    numbered = _by_numbers(found, ("row", "column"))
    top, left = min(row for row, _ in numbered), min(column for _, column in numbered)
    return {(row - top, column - left): one.path for (row, column), one in numbered.items()}


def _row_major(folder: Path, found: list[Found]) -> dict[grid.Cell, Path]:
    """Views of a square grid that are numbered through, counted from the smallest."""
    numbered = _by_numbers(found, ("index",))
    first, last = min(numbered)[0], max(numbered)[0]
    side = math.isqrt(last - first) + 1
    absent = next((index for index in range(first, first + side**2) if (index,) not in numbered), None)
    if absent is not None:
        expected = f"{folder} must hold a square number of views, {side}x{side} for numbers up to {last}"
        got = f"{len(numbered)}, no {found[0].renamed({'index': absent})}"
        raise FileError(expected, got=got, remedy="add the missing views, or give pattern with row and column")
    return {divmod(index - first, side): one.path for (index,), one in numbered.items()}


ARRANGEMENTS: dict[tuple[str, ...], Callable[[Path, list[Found]], dict[grid.Cell, Path]]] = {
    ("row", "column"): _by_row_and_column,
    ("index",): _row_major,
}


def _namer(example: Found, cells: Mapping[grid.Cell, Path]) -> Callable[[grid.Cell], str]:
    """What names a missing view after one that is there."""
    if "row" not in example.match.re.groupindex:
        return str
    row, column = example.numbers(("row", "column"))
    at = next(cell for cell, path in cells.items() if path == example.path)
    return lambda cell: example.renamed({"row": row - at[0] + cell[0], "column": column - at[1] + cell[1]})
