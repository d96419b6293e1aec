"""Writing folders of images, all of it or nothing, in the place of nothing but an older one of ours.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from lfref import encoding
from lfref.encoding import Encoding
from lfref.errors import FileError, InputError
from lfref.io import atomic, grid, images, ownership

# PART names
# How the files of views are named: which number of a name is the row, the column, or the place in row-major order.
#
# Known are the Stanford gantry (`out_RR_CC_Y_X.png`), the HCI benchmark (`input_Cam000.png`), numbers behind letters
# (`v03_u04`, `row3_col4`), a row and a column (`03_04`, `view-3-4`, `NAME_03x04`) and plain numbers (`000.png`).

_ROW, _COLUMN = r"(?P<row>\d{1,3})", r"(?P<column>\d{1,3})"
_V, _U = rf"(?:row|r|v|t)[_-]?{_ROW}", rf"(?:column|col|c|u|s)[_-]?{_COLUMN}"
PATTERNS: dict[str, str] = {
    "gantry": r"^(?P<name>out)_(?P<row>\d+)_(?P<column>\d+)_(?P<v>-?\d+\.\d+)_(?P<u>-?\d+\.\d+)_?\.\w+$",
    "HCI": r"^(?P<name>input_Cam)(?P<index>\d+)\.\w+$",
    "v_u": rf"(?i)^(?P<name>|.*[^a-z]){_V}[_-]?{_U}\.\w+$",
    "u_v": rf"(?i)^(?P<name>|.*[^a-z]){_U}[_-]?{_V}\.\w+$",
    # Numbers of more digits are dates and counters of cameras, those right behind letters belong to a name.
    "row_column": rf"^(?P<name>|.*[^a-zA-Z\d]){_ROW}[_x-]{_COLUMN}\.\w+$",
}
"""Name of a pattern -> its expression; a file is of the first that it follows."""
ASKED: dict[str, str] = {
    "column_row": rf"^(?P<name>|.*[^a-zA-Z\d]){_COLUMN}[_x-]{_ROW}\.\w+$",
    "index": r"^(?P<name>|.*\D)(?P<index>\d+)\.\w+$",
}
"""Those that names alone do not tell: `column_row` from `row_column`, `index` from unrelated pictures."""
GROUPS = (("row", "column"), ("index",))
"""The named groups that a pattern may have."""


class Found(NamedTuple):
    """A file that follows a pattern."""

    path: Path
    match: re.Match[str]

    @property
    def field(self) -> tuple[str, str]:
        """What the files of one light field have in common."""
        return self.match.re.pattern, self.match.groupdict().get("name") or ""

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


def numbering(regex: re.Pattern[str]) -> tuple[str, ...]:
    """Which groups of a pattern say where a view belongs."""
    return tuple(group for group in ("row", "column", "index") if group in regex.groupindex)


def compiled(pattern: str) -> re.Pattern[str]:
    """A user's pattern, once it is known to be usable.

    Args:
        pattern: A name of `PATTERNS` or `ASKED`, or a regular expression.

    Raises:
        InputError: It is neither, or has other groups than a row and a column, or an index.
    """
    known = PATTERNS | ASKED
    expected = f"pattern (reader.pattern) must be {', '.join(known)} or a regular expression"
    try:
        regex = re.compile(known.get(pattern, pattern))
    except re.error as error:
        raise InputError(expected, got=f"{pattern!r} ({error})") from error
    if numbering(regex) not in GROUPS:
        raise InputError(f"{expected} with the named groups row and column, or index", got=repr(pattern))
    return regex


def following(files: Iterable[Path], patterns: Iterable[re.Pattern[str]]) -> list[list[Found]]:
    """The files that follow patterns, those of one light field together.

    Args:
        files: Paths of files.
        patterns: A file is of the first that it follows.
    """
    fields: dict[tuple[str, str], list[Found]] = {}
    patterns = list(patterns)
    for path in files:
        matches = (pattern.search(path.name) for pattern in patterns)
        if match := next(filter(None, matches), None):
            found = Found(path, match)
            fields.setdefault(found.field, []).append(found)
    return list(fields.values())


def known(files: Iterable[Path]) -> list[list[Found]]:
    """The light fields whose names leave no doubt, as `following`."""
    return following(files, map(re.compile, PATTERNS.values()))


def numbered(files: Iterable[Path]) -> list[list[Found]]:
    """The files that are numbered through, as `following`; a picture on its own counts only if there are no others."""
    fields = following(files, [re.compile(ASKED["index"])])
    return [field for field in fields if len(field) > 1] or fields


def is_numbered(files: Iterable[Path]) -> bool:
    """Whether the names of a light field are of no pattern but that they are numbered through."""
    return not known(files)


def by_numbers(found: list[Found], groups: tuple[str, ...]) -> dict[tuple[int, ...], Found]:
    """Numbers in the name -> file, each only once.

    Raises:
        InputError: A group of a user's pattern is no number.
        FileError: Two files have the same numbers.
    """
    numbers: dict[tuple[int, ...], Found] = {}
    for one in found:
        try:
            key = one.numbers(groups)
        except (TypeError, ValueError) as error:
            raise InputError(f"groups of pattern must be numbers in {one.path}", got=error) from error
        if key in numbers:
            got, remedy = f"{numbers[key].path.name} and {one.path.name}", "remove one of them, or give reader.pattern"
            raise FileError(f"{one.path.parent} must hold each view once", got=got, remedy=remedy)
        numbers[key] = one
    return numbers


# PART arrangements
# From the names of views to their rows and columns: numbers of rows and columns, or places in row-major order.


class Arrangement(NamedTuple):
    """Where the files of a light field belong."""

    cells: dict[grid.Cell, Found]
    """File at each row and column from 0."""
    shape: tuple[int, int]
    """Rows and columns of the grid, of which some may be missing."""
    name_of: Callable[[grid.Cell], str]
    """What the file at a row and column would be called."""


def of(folder: Path, found: list[Found], selection: grid.Selection) -> Arrangement:
    """Where the files of a light field belong.

    Args:
        folder: Of the files, for messages.
        found: The files, all of one pattern.
        selection: Whether the pattern was asked for, and the grid.

    Raises:
        FileError: Two files are the same view, or names leave open where views belong.
        InputError: Names that hold no numbers, or a grid that does not fit.
    """
    return ARRANGEMENTS[numbering(found[0].match.re)](folder, found, selection)


def _by_row_and_column(folder: Path, found: list[Found], selection: grid.Selection) -> Arrangement:
    """Views at their rows and columns, counted from the smallest, in steps of what all of them have in common."""
    numbered = by_numbers(found, ("row", "column"))
    if selection.pattern is None:
        _check_row(folder, found)
    top, left = min(row for row, _ in numbered), min(column for _, column in numbered)
    step = math.gcd(*(number for row, column in numbered for number in (row - top, column - left))) or 1
    cells = {((row - top) // step, (column - left) // step): one for (row, column), one in numbered.items()}

    def name_of(cell: grid.Cell) -> str:
        return found[0].renamed({"row": top + step * cell[0], "column": left + step * cell[1]})

    return Arrangement(cells, grid.extent(cells), name_of)


def _check_row(folder: Path, found: list[Found]) -> None:
    """Refuse a single row of a square number of views unless its numbers are as wide as each other.

    `cam_1_01` to `cam_1_81` may be a row of 81 views, or a camera's 9x9 numbered through.
    """
    is_row = len({one.match["row"] for one in found}) == 1
    is_even = all(len(one.match["row"]) == len(one.match["column"]) for one in found)
    if is_row and not is_even and math.isqrt(len(found)) ** 2 == len(found) > 1:
        got = f"{len(found)} views named like {found[0].path.name}"
        remedy = "give reader.pattern=index for a square grid row by row, or reader.pattern=row_column for one row"
        raise FileError(f"{folder} must say its rows and columns", got=got, remedy=remedy)


def _row_major(folder: Path, found: list[Found], selection: grid.Selection) -> Arrangement:
    """Views that are numbered through row by row, of a square grid unless another is asked for."""
    numbered = by_numbers(found, ("index",))
    shape, base = _square_or_asked(folder, found, [index for (index,) in numbered], selection.grid)
    cells = {divmod(index - base, shape[1]): one for (index,), one in numbered.items()}
    return Arrangement(cells, shape, lambda cell: found[0].renamed({"index": base + shape[1] * cell[0] + cell[1]}))


def _square_or_asked(
    folder: Path, found: list[Found], numbers: list[int], asked: tuple[int, int] | None
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


ARRANGEMENTS: dict[tuple[str, ...], Callable[[Path, list[Found], grid.Selection], Arrangement]] = {
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


# PART views
# Folders of sub-aperture views: which file is the view at which row and column.
#
# How names say it stands in `names`. Files that are only numbered through are taken for the views of a square grid, row
# by row, where nothing speaks against it.

SUFFIXES = [suffix for picture in images.FORMATS.values() for suffix in picture.suffixes]
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
    with atomic.file_errors(folder, "read"):
        files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    return sorted(path for path in files if not path.name.startswith("."))


def is_field(folder: Path) -> bool:
    """Whether a folder holds files that are named like sub-aperture views."""
    files = image_files(folder)
    return bool(known(files)) or any(_is_numbered_field(found) for found in numbered(files))


def is_view(path: Path) -> bool:
    """Whether a file is named like a view, beyond doubt, and has others beside it."""
    fields = known(image_files(path.parent))
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
    return grid.gather(stored, selection.window(stored.shape, folder), images.read_image, str, selection.room)


def stored_grid(folder: Path, selection: grid.Selection) -> grid.Grid[Path]:
    """Which file is the view at which row and column; arguments and errors as `read_views`."""
    found = _one_field(folder, selection.pattern)
    cells, shape, name_of = of(folder, found, selection)
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
    if None in paths or not is_numbered(stored.cells.values()):
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


def _one_field(folder: Path, pattern: str | None) -> list[Found]:
    """The files of the only light field in a folder."""
    files = image_files(folder)
    if not files:
        raise FileError(f"{folder} must hold images", got="none", remedy=f"put in {', '.join(SUFFIXES)} files")
    fields = _guessed(files) if pattern is None else following(files, [compiled(pattern)])
    if not fields:
        got = f"{len(files)} images named like {files[0].name}"
        remedy = "give reader.pattern: index (row by row), or a regular expression with groups row and column"
        raise FileError(f"{folder} must hold views whose names say their rows and columns", got=got, remedy=remedy)
    if len(fields) > 1:
        got = " and ".join(field[0].path.name for field in fields[:2])
        raise FileError(f"{folder} must hold one light field", got=got, remedy="move one away, or give reader.pattern")
    return fields[0]


def _guessed(files: list[Path]) -> list[list[Found]]:
    """The light fields whose names say where their views belong, else those that are numbered through."""
    return known(files) or [found for found in numbered(files) if _is_numbered_field(found)]


def _is_numbered_field(found: list[Found]) -> bool:
    """Whether numbered pictures may be taken for views without being asked: a square number of them, and small."""
    numbers = [one.numbers(("index",)) for one in found]
    if len(set(numbers)) < len(numbers):
        return False
    first, last = min(numbers)[0], max(numbers)[0]
    if square(first, last, len(numbers)) is None or len(numbers) < FEWEST_NUMBERED:
        return False
    return min(images.image_size(found[0].path)) < LARGEST_NUMBERED


# PART headers
# What files say about their samples, without reading them.

GAMMAS = (0.1, 10.0)
"""Least and greatest exponent that is believed."""


def encoding_of(path: Path) -> Encoding | None:
    """How a file's samples stand for light, as its header says (PNG: sRGB and gAMA chunks; EXIF of JPEG and TIFF).

    Args:
        path: An image file, or a folder of views, whose first file speaks for all.

    Returns:
        The encoding; None where nothing is said, or nothing that we know.

    Raises:
        FileError: The file is missing or damaged.
    """
    files = image_files(path)[:1] if path.is_dir() else [path]
    if not files or images.format_of_head(images.read_head(files[0])) is None:
        return None
    with images.open_image(files[0]) as source:
        spec = source.spec()
    return _told(spec)


def _told(spec: OpenImageIO.ImageSpec) -> Encoding | None:
    space = spec.get_string_attribute("oiio:ColorSpace").lower()
    gamma = spec.get_float_attribute("oiio:Gamma", 0.0)
    if space.startswith(("lin", "scene_linear")):
        return encoding.LINEAR
    if GAMMAS[0] <= gamma <= GAMMAS[1] and gamma != 1:
        return encoding.parsed(f"gamma:{gamma:.4g}")
    return encoding.SRGB if space.startswith("srgb") else None


AT_ONCE = 4
"""Images that are compressed at the same time, and held in memory."""


def write_views(path: Path, views: NDArray, bits: int | None = None) -> None:
    """Write a light field as a folder of PNG images `NAME_RR_CC.png`, named after the folder.

    Args:
        path: The folder.
        views: Floating point, clipped to [0, 1]; 2 or 4 channels: the last is a weight, [V, U, C, H, W].
        bits: 8 (default) or 16.

    Raises:
        InputError: NaN or infinity, or another depth or channel count.
        FileError: The disk refuses, or the folder holds anything but such a light field of ours.
    """
    # A leading dot would hide the files from the reader.
    stem = path.absolute().name.lstrip(".") or "view"
    images.sample_type(path / "x.png", bits)
    named = ((f"{stem}_{row:02d}_{column:02d}.png", views[row, column]) for row, column in np.ndindex(views.shape[:2]))
    write_images(path, named, "views", bits)


def write_images(
    path: Path, named: Iterable[tuple[str, NDArray]], kind: str, bits: int | None, quality: int = images.QUALITY
) -> None:
    """Write PNG or JPEG images as a folder, which takes the place of an older one of its kind.

    Args:
        path: The folder.
        named: Name and image, floating point, [C, H, W], of each file.
        kind: As `marks.check_folder`.
        bits: 8 (default) or 16, which PNG has.
        quality: Of JPEG images, from 1 to 100.

    Raises:
        InputError: NaN or infinity, or another depth or channel count.
        FileError: The disk refuses, or the folder holds anything but such a folder of ours.
    """
    ownership.check_folder(path, kind)
    with atomic.replacing_folder(path) as partial:
        _write_all(((partial / name, image.transpose(1, 2, 0)) for name, image in named), bits, quality)
        ownership.write_mark(partial, kind, ownership.digests(partial, ownership.files_below(partial)))


def _write_all(named: Iterable[tuple[Path, NDArray]], bits: int | None, quality: int) -> None:
    """Write images, a few at a time: compression is most of the work, and lets go of the interpreter's lock."""
    under_way = deque[Future[None]]()
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for path, image in named:
            if len(under_way) == AT_ONCE:
                under_way.popleft().result()
            under_way.append(pool.submit(images.write_image, path, image, bits=bits, quality=quality))
        for file in under_way:
            file.result()
