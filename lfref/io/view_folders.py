"""Folders of sub-aperture views: names -> arrangement on the grid -> decoding; and writing such folders.

Known names are those of the Stanford gantry (`out_RR_CC_Y_X.png`, `NAME_RR_CC_Y_X_30_36.jpg`), the HCI benchmark
(`input_Cam000.png`), a pair (`left.png`, `right.png`), numbers behind letters (`v03_u04`, `row3_col4`), a row and a
column (`03_04`, `view-3-4`, `NAME_03x04`, `view_-1_+2`), and plain numbers (`000.png`): views of a square grid, row by
row, if number and size allow it.
Other pictures of the folder are left out, and named in the log.
Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

import logging
import math
import re
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError, counted
from lfref.io import atomic, images, samples
from lfref.io.samples import Cell, ReadOptions, Samples

log = logging.getLogger(__name__)

FEWEST_NUMBERED = 9
"""Fewest numbered pictures that count as views: other pictures rarely are so many, and a square number."""
BESIDE = "_truth", "_disparity", "_all_in_focus", "_masks", "_sheet"
"""Ends of the names of pictures that `lfref simulate` writes beside views."""
N_WRITERS = 4
"""Number of images that are compressed, and held in memory, at the same time."""

_ROW, _COLUMN = r"(?P<row>\d{1,3})", r"(?P<column>\d{1,3})"
# A sign stands behind what separates numbers: view_-1_+2; in view-1-2 it separates them.
_SIGNED_ROW, _SIGNED_COLUMN, _BETWEEN = r"(?P<row>[+-]?\d{1,3})", r"(?P<column>[+-]?\d{1,3})", "[_x-]"
_POSITION = r"-?\d+\.\d+"
_V, _U = rf"(?:row|r|v|t)[_-]?{_ROW}", rf"(?:column|col|c|u|s)[_-]?{_COLUMN}"
_INDEX = r"^(?P<name>|.*\D)(?P<index>\d+)\.\w+$"
SIDES = {"left": 0, "right": 1}
"""Words that stand for numbers in the names of a pair of views, in small letters."""
PATTERNS: dict[str, str] = {
    # Numbers behind the position, such as 30_36, belong to the camera.
    "gantry": rf"^(?P<name>|.*[^a-zA-Z\d]){_ROW}_{_COLUMN}_(?P<v>{_POSITION})_(?P<u>{_POSITION})(?:_[\d.]*)*\.\w+$",
    "HCI": r"^(?P<name>input_Cam)(?P<index>\d+)\.\w+$",
    "left_right": rf"(?i)^(?P<name>|.*[^a-z])(?P<index>{'|'.join(SIDES)})\.\w+$",
    "v_u": rf"(?i)^(?P<name>|.*[^a-z]){_V}[_-]?{_U}\.\w+$",
    "u_v": rf"(?i)^(?P<name>|.*[^a-z]){_U}[_-]?{_V}\.\w+$",
    # Numbers of more than 3 digits are dates or counters of cameras; numbers right behind letters belong to a name.
    "row_column": rf"^(?P<name>|.*?[^a-zA-Z\d]){_SIGNED_ROW}{_BETWEEN}{_SIGNED_COLUMN}\.\w+$",
}
"""Name of a pattern -> regular expression; a file has the first pattern that it matches."""
AMBIGUOUS_PATTERNS: dict[str, str] = {
    "column_row": rf"^(?P<name>|.*?[^a-zA-Z\d]){_SIGNED_COLUMN}{_BETWEEN}{_SIGNED_ROW}\.\w+$",
    "index": _INDEX,
    "serpentine": _INDEX,
}
"""Further patterns, which count only where the user names them; `serpentine` runs to the left in every second row."""


Named = re.Match[str]
"""A file name (`string`) that matches a pattern."""


def groups_of(regex: re.Pattern[str]) -> list[str]:
    """The named groups for the place of a view: `row` and `column`, or `index`."""
    return [group for group in ("row", "column", "index") if group in regex.groupindex]


def compiled(pattern: str) -> re.Pattern[str]:
    """The regular expression of the option `pattern`, which is a name in the two tables, or an expression itself."""
    known = PATTERNS | AMBIGUOUS_PATTERNS
    try:
        regex = re.compile(known.get(pattern, pattern))
        if groups_of(regex) in (["row", "column"], ["index"]):
            return regex
        reason = "other groups"
    except re.error as error:
        reason = str(error)
    expected = f"reader.pattern must be {', '.join(known)} or a regular expression with groups row and column, or index"
    raise InputError(expected, got=f"{pattern!r} ({reason})")


def fields_of(
    files: Iterable[Path], patterns: Iterable[str | re.Pattern[str]] = PATTERNS.values()
) -> list[list[Named]]:
    """The files that match a pattern, one list per light field (one pattern and one name)."""
    fields: dict[tuple[str, str], list[Named]] = {}
    expressions = [re.compile(pattern) for pattern in patterns]
    for path in files:
        match = next(filter(None, (expression.search(path.name) for expression in expressions)), None)
        if match:
            key = match.re.pattern, match.groupdict().get("name") or ""
            fields.setdefault(key, []).append(match)
    return list(fields.values())


def numbered_fields(files: Iterable[Path]) -> list[list[Named]]:
    """The numbered files that count as views without the option `pattern`, one list per name: a square number."""

    def is_square(field: list[Named]) -> bool:
        numbers = {int(file["index"]) for file in field}
        is_enough = len(numbers) == len(field) >= FEWEST_NUMBERED
        return is_enough and square(min(numbers), max(numbers), len(numbers)) is not None

    return list(filter(is_square, fields_of(files, [AMBIGUOUS_PATTERNS["index"]])))


def image_files(folder: Path) -> list[Path]:
    """The image files of a folder, by suffix, sorted; hidden ones and those beside simulated views are left out."""
    with atomic.file_errors(folder, "read"):
        files = [path for path in folder.iterdir() if path.suffix.lower() in images.SUFFIXES and path.is_file()]
    return sorted(path for path in files if not path.name.startswith(".") and not path.stem.endswith(BESIDE))


def is_field(folder: Path) -> bool:
    """Whether a folder holds files that are named like sub-aperture views."""
    files = image_files(folder)
    return bool(fields_of(files) or numbered_fields(files))


def arrange(folder: Path, field: list[Named], options: ReadOptions) -> tuple[dict[Cell, Named], Cell]:
    """The file at each row and column, and the shape of the grid, of files of one pattern."""
    groups = groups_of(field[0].re)
    try:
        numbers = [tuple(_number(file[group]) for group in groups) for file in field]
    except (TypeError, ValueError) as error:
        raise InputError("groups of reader.pattern must be numbers in all names", got=error) from error
    numbered = dict(zip(numbers, field, strict=True))
    if len(numbered) < len(field):
        first, second = [file.string for n, file in zip(numbers, field, strict=True) if numbers.count(n) > 1][:2]
        raise FileError(f"{folder} must hold each view once", got=f"{first} and {second}", remedy="remove one of them")
    if groups == ["index"]:
        is_pair = field[0]["index"].lower() in SIDES
        grid = options.grid or ((1, 2) if is_pair else None)
        shape, base = _square_or_option(folder, field, [index for (index,) in numbered], grid)
        is_serpentine = options.pattern == "serpentine"
        places = (samples.cell_of(index - base, shape[1], is_serpentine) for (index,) in numbered)
        return dict(zip(places, numbered.values(), strict=True)), shape
    # Rows and columns may begin at any number and count in any common step.
    top, left = min(row for row, _ in numbered), min(column for _, column in numbered)
    step = math.gcd(*(number for row, column in numbered for number in (row - top, column - left))) or 1
    cells = {((row - top) // step, (column - left) // step): file for (row, column), file in numbered.items()}
    return cells, samples.extent(cells)


def _number(text: str) -> int:
    side = SIDES.get(str(text).lower())
    return int(text) if side is None else side


def _square_or_option(
    folder: Path, field: list[Named], numbers: list[int], shape: tuple[int, int] | None
) -> tuple[tuple[int, int], int]:
    """Rows and columns of a grid whose views are numbered row by row, and its first number."""
    first, last, count = min(numbers), max(numbers), len(numbers)
    if shape is None and (side_and_base := square(first, last, count)):
        side, base = side_and_base
        return (side, side), base
    n_views = 0 if shape is None else math.prod(shape)
    base = first if last - first + 1 == n_views else min(first, 1)
    if shape is not None and last - base < n_views:
        return shape, base
    expected = f"{folder} must hold a square number of views, or those of reader.grid, numbered row by row"
    got = f"{counted(count, 'view')} like {field[0].string}, numbered {first} to {last}"
    remedy = "add the missing views, or set reader.grid=[rows,columns]"
    raise FileError(expected, got=got, remedy=remedy, proposals=samples.grids_of(count))


def square(first: int, last: int, count: int) -> tuple[int, int] | None:
    """Side and first number of a square grid, numbered from 0 or 1 with holes, or from any number; None if none."""
    side = math.isqrt(count)
    if side**2 == count == last - first + 1:
        return side, first
    # Holes are usually symmetric about the middle: first + last = 2 base + side^2 - 1. Only one base fits.
    for base in (0, 1):
        side = math.isqrt(max(0, first + last - 2 * base) + 1)
        if side**2 - 1 == first + last - 2 * base and count < side**2:
            return side, base
    return None


def decode_folder(folder: Path, options: ReadOptions) -> Samples:
    """The chosen views of a folder."""
    cells, shape = arrange(folder, _only_field(folder, options.pattern), options)
    paths = {cell: folder / file.string for cell, file in cells.items()}
    samples.check_holes(paths, shape, folder, options.holes)
    if others := sorted({*image_files(folder)} - {*paths.values()}):
        names = ", ".join(path.name for path in others[:5])
        log.info("%s: left out %s, since they are no views: %s", folder, counted(len(others), "picture"), names)
    colours, weight = samples.gather(paths, options.window(shape, folder), images.read_image)
    tone = images.encoding_of(next(iter(paths.values())), options.encoding, images.usual_encoding(colours))
    return Samples(colours, weight, tone, shape)


def _only_field(folder: Path, pattern: str | None) -> list[Named]:
    """The files of the only light field in a folder."""
    files = image_files(folder)
    if pattern is not None:
        fields = fields_of(files, [compiled(pattern)])
    else:
        # A single name beside a light field is that of another picture, such as a depth map.
        named = fields_of(files)
        fields = [field for field in named if len(field) > 1]
        fields = fields or numbered_fields(files) or named
    if len(fields) != 1:
        names = [field[0].string for field in fields[:2]] or [path.name for path in files[:1]] or ["none"]
        below = [child.name for child in sorted(folder.iterdir()) if child.is_dir() and is_field(child)]
        got = f"{counted(len(files), 'image')} named like {' and '.join(names)}"
        remedy = "give a regular expression with groups row and column as reader.pattern"
        proposals = [{"pattern": "index"} | grid for grid in [{}, *samples.grids_of(len(files))]]
        if below:
            remedy, proposals = f"read {folder / below[0]}", []
        expected = f"{folder} must hold the views of one light field, whose names say their rows and columns"
        raise FileError(expected, got=got, remedy=remedy, proposals=proposals)
    return fields[0]


def positions_in_names(folder: Path, options: ReadOptions) -> NDArray[np.float64]:
    """Camera positions (v, u) of the chosen views by their names, in the names' own unit, NaN at holes, [V, U, 2]."""
    cells, shape = arrange(folder, _only_field(folder, options.pattern), options)
    positions = np.full((*shape, 2), np.nan)
    for cell, file in cells.items():
        if not {"v", "u"} <= file.re.groupindex.keys():
            expected = f"{folder / file.string} must be named NAME_RR_CC_Y_X for positions=names"
            raise FileError(expected, remedy="give a CSV file as reader.positions")
        positions[cell] = float(file["v"]), float(file["u"])
    return positions[options.window(shape, folder)]


def write_views(path: Path, views: NDArray, bits: int | None = None) -> None:
    """Write views, floating point, [V, U, C, H, W], as PNG images `NAME_RR_CC.png` named after the folder."""
    # A leading dot would hide the files from the reader.
    stem = path.absolute().name.lstrip(".") or "view"
    named = ((f"{stem}_{row:02d}_{column:02d}.png", views[row, column]) for row, column in np.ndindex(views.shape[:2]))
    write_images(path, named, bits)


def write_images(
    path: Path, named: Iterable[tuple[str, NDArray]], bits: int | None, quality: int = images.QUALITY
) -> None:
    """Write named images [C, H, W] into a folder, which is new as a whole, or gets all images that are not there."""
    with atomic.filling_folder(path) as partial, ThreadPoolExecutor(N_WRITERS) as pool:
        # Several images at a time: compression is most of the work, and releases the interpreter's lock.
        running = deque[Future[None]]()
        for name, image in named:
            if len(running) == N_WRITERS:
                running.popleft().result()
            channels_last = image.transpose(1, 2, 0)
            running.append(pool.submit(images.write_image, partial / name, channels_last, bits=bits, quality=quality))
        for future in running:
            future.result()
