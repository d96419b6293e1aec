"""Folders of sub-aperture views: naming patterns -> arrangement on the grid -> decoding; and writing such folders.

Known names are those of the Stanford gantry (`out_RR_CC_Y_X.png`), the HCI benchmark (`input_Cam000.png`), numbers
behind letters (`v03_u04`, `row3_col4`), a row and a column (`03_04`, `view-3-4`, `NAME_03x04`), and plain numbers
(`000.png`). Pictures with plain numbers are views of a square grid, row by row, if number, size and contents allow it.

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
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref.encoding import Encoding
from lfref.errors import FileError, InputError, counted
from lfref.io import atomic, grid, images, ownership
from lfref.io.options import ReadOptions
from lfref.io.scratch import allocator

_ROW, _COLUMN = r"(?P<row>\d{1,3})", r"(?P<column>\d{1,3})"
_V, _U = rf"(?:row|r|v|t)[_-]?{_ROW}", rf"(?:column|col|c|u|s)[_-]?{_COLUMN}"
PATTERNS: dict[str, str] = {
    "gantry": r"^(?P<name>out)_(?P<row>\d+)_(?P<column>\d+)_(?P<v>-?\d+\.\d+)_(?P<u>-?\d+\.\d+)_?\.\w+$",
    "HCI": r"^(?P<name>input_Cam)(?P<index>\d+)\.\w+$",
    "v_u": rf"(?i)^(?P<name>|.*[^a-z]){_V}[_-]?{_U}\.\w+$",
    "u_v": rf"(?i)^(?P<name>|.*[^a-z]){_U}[_-]?{_V}\.\w+$",
    # Numbers of more than 3 digits are dates or counters of cameras; numbers right behind letters belong to a name.
    "row_column": rf"^(?P<name>|.*[^a-zA-Z\d]){_ROW}[_x-]{_COLUMN}\.\w+$",
}
"""Name of a pattern -> regular expression; a file has the first pattern that it matches."""
AMBIGUOUS_PATTERNS: dict[str, str] = {
    "column_row": rf"^(?P<name>|.*[^a-zA-Z\d]){_COLUMN}[_x-]{_ROW}\.\w+$",
    "index": r"^(?P<name>|.*\D)(?P<index>\d+)\.\w+$",
}
"""Further patterns: names alone do not tell `column_row` from `row_column`, nor `index` from unrelated pictures."""
FEWEST_NUMBERED = 9
"""Fewest numbered pictures that count as views: other pictures rarely are so many, and a square number."""
ROW_RATIO = 1.5
"""Difference of a view from the one below, over that from the next one, above which pictures count as one row."""
LARGEST_NUMBERED = 2500
"""Height and width, in pixels, from which numbered pictures may be lenslet images of several scenes."""
GAMMAS = (0.1, 10.0)
"""Smallest and largest plausible exponent in a header."""
N_WRITERS = 4
"""Number of images that are compressed, and held in memory, at the same time."""


class NamedFile(NamedTuple):
    """A file that matches a pattern."""

    path: Path
    match: re.Match[str]

    def renamed(self, numbers: Mapping[str, int]) -> str:
        """The name that the file would have with other numbers."""
        name = self.match.string
        for group in sorted(numbers, key=self.match.start, reverse=True):
            first, last = self.match.span(group)
            name = f"{name[:first]}{numbers[group]:0{last - first}d}{name[last:]}"
        return name


def _groups(regex: re.Pattern[str]) -> list[str]:
    """The named groups for the place of a view: `row` and `column`, or `index`."""
    return [group for group in ("row", "column", "index") if group in regex.groupindex]


def compiled(pattern: str) -> re.Pattern[str]:
    """The regular expression of the option `pattern`, which is a name in the two tables, or an expression itself."""
    known = PATTERNS | AMBIGUOUS_PATTERNS
    expected = f"pattern (reader.pattern) must be {', '.join(known)} or a regular expression"
    try:
        regex = re.compile(known.get(pattern, pattern))
    except re.error as error:
        raise InputError(expected, got=f"{pattern!r} ({error})") from error
    if _groups(regex) not in (["row", "column"], ["index"]):
        raise InputError(f"{expected} with the named groups row and column, or index", got=repr(pattern))
    return regex


def fields_of(
    files: Iterable[Path], patterns: Iterable[str | re.Pattern[str]] = PATTERNS.values()
) -> list[list[NamedFile]]:
    """The files that match a pattern, one list per light field (one pattern and one name)."""
    fields: dict[tuple[str, str], list[NamedFile]] = {}
    expressions = [re.compile(pattern) for pattern in patterns]
    for path in files:
        match = next(filter(None, (expression.search(path.name) for expression in expressions)), None)
        if match:
            key = match.re.pattern, match.groupdict().get("name") or ""
            fields.setdefault(key, []).append(NamedFile(path, match))
    return list(fields.values())


def numbered_fields(files: Iterable[Path]) -> list[list[NamedFile]]:
    """The files that are numbered, one list per name; a name with one picture counts only if no name has more."""
    fields = fields_of(files, [AMBIGUOUS_PATTERNS["index"]])
    return [field for field in fields if len(field) > 1] or fields


def _looks_like_views(field: list[NamedFile]) -> bool:
    """Whether numbered pictures count as views without the option `pattern`: they are a square number, and small."""
    numbers = {int(file.match["index"]) for file in field}
    if len(numbers) < len(field) or len(numbers) < FEWEST_NUMBERED:
        return False
    if square(min(numbers), max(numbers), len(numbers)) is None:
        return False
    return min(images.image_size(field[0].path)) < LARGEST_NUMBERED


def image_files(folder: Path) -> list[Path]:
    """The image files of a folder, by suffix, hidden ones left out, sorted."""
    with atomic.file_errors(folder, "read"):
        files = [path for path in folder.iterdir() if path.suffix.lower() in images.SUFFIXES and path.is_file()]
    return sorted(path for path in files if not path.name.startswith("."))


def is_field(folder: Path) -> bool:
    """Whether a folder holds files that are named like sub-aperture views."""
    files = image_files(folder)
    return bool(fields_of(files)) or any(map(_looks_like_views, numbered_fields(files)))


def is_view(path: Path) -> bool:
    """Whether a file is named like a view, unambiguously, and has others beside it."""
    fields = fields_of(image_files(path.parent))
    return any(len(field) > 1 and path in [file.path for file in field] for field in fields)


class Arrangement(NamedTuple):
    """Places of a light field's files on the grid."""

    cells: dict[grid.Cell, NamedFile]
    """File at each row and column from 0."""
    shape: tuple[int, int]
    """Rows and columns of the grid; some views may be missing."""
    name_of: Callable[[grid.Cell], str]
    """Name that the file at a row and column should have."""


def arrange(folder: Path, field: list[NamedFile], options: ReadOptions) -> Arrangement:
    """Places on the grid of files of one pattern, by the options `pattern` and `grid`."""
    groups = _groups(field[0].match.re)
    numbered: dict[tuple[int, ...], NamedFile] = {}
    for file in field:
        try:
            key = tuple(int(file.match[group]) for group in groups)
        except (TypeError, ValueError) as error:
            raise InputError(f"groups of pattern must be numbers in {file.path}", got=error) from error
        if key in numbered:
            got = f"{numbered[key].path.name} and {file.path.name}"
            remedy = "remove one of them, or give reader.pattern"
            raise FileError(f"{file.path.parent} must hold each view once", got=got, remedy=remedy)
        numbered[key] = file
    if groups == ["index"]:
        shape, base = _square_or_option(folder, field, [index for (index,) in numbered], options.grid)
        cells = {divmod(index - base, shape[1]): file for (index,), file in numbered.items()}
        return Arrangement(cells, shape, lambda cell: field[0].renamed({"index": base + shape[1] * cell[0] + cell[1]}))

    # `cam_1_01` to `cam_1_81` may be one row of 81 views, or 9x9 numbered views of camera 1. Names are ambiguous
    # unless the numbers of row and column have equally many digits.
    is_one_row = len({row for row, _ in numbered}) == 1
    is_even = all(len(file.match["row"]) == len(file.match["column"]) for file in field)
    if options.pattern is None and is_one_row and not is_even and math.isqrt(len(field)) ** 2 == len(field) > 1:
        got = f"{counted(len(field), 'view')} named like {field[0].path.name}"
        remedy = "give reader.pattern=index for a square grid row by row, or reader.pattern=row_column for one row"
        raise FileError(f"{folder} must say its rows and columns", got=got, remedy=remedy)
    # Rows and columns may begin at any number and count in any common step.
    top, left = min(row for row, _ in numbered), min(column for _, column in numbered)
    step = math.gcd(*(number for row, column in numbered for number in (row - top, column - left))) or 1
    cells = {((row - top) // step, (column - left) // step): file for (row, column), file in numbered.items()}

    def name_of(cell: grid.Cell) -> str:
        return field[0].renamed({"row": top + step * cell[0], "column": left + step * cell[1]})

    return Arrangement(cells, grid.extent(cells), name_of)


def _square_or_option(
    folder: Path, field: list[NamedFile], numbers: list[int], shape: tuple[int, int] | None
) -> tuple[tuple[int, int], int]:
    """Rows and columns of a grid whose views are numbered row by row, and its first number."""
    first, last, count = min(numbers), max(numbers), len(numbers)
    if shape is not None:
        n_views = shape[0] * shape[1]
        base = first if last - first + 1 == n_views else min(first, 1)
        if min(shape) < 1 or last - base >= n_views:
            got, remedy = f"{counted(count, 'view')} numbered {first} to {last}", "set reader.grid to fit"
            raise InputError(f"{folder} must hold {shape[0]}x{shape[1]} views", got=got, remedy=remedy)
        return shape, base
    if side_and_base := square(first, last, count):
        side, base = side_and_base
        return (side, side), base
    side = math.isqrt(last - first) + 1
    present = set(numbers)
    absent = next(index for index in range(first, first + side**2) if index not in present)
    expected = f"{folder} must hold a square number of views, {side}x{side} for numbers up to {last}"
    got = f"{count}, no {field[0].renamed({'index': absent})}"
    raise FileError(expected, got=got, remedy="add the missing views, or give reader.grid=[rows,columns]")


def square(first: int, last: int, count: int) -> tuple[int, int] | None:
    """The square grid of views that are numbered through from 0 or 1, or from any number without holes.

    Holes of a grid are usually symmetric about its middle. Then first + last = 2 base + side^2 - 1, where `base`, 0 or
    1, is the number at which a grid without holes begins. Only one base fits, since no two squares differ by 2.

    Returns:
        Number of rows (and of columns), and the number of the first view; None if there is no such grid.
    """
    side = math.isqrt(count)
    if side**2 == count == last - first + 1:
        return side, first
    for base in (0, 1):
        side = math.isqrt(max(0, first + last - 2 * base) + 1)
        if side**2 - 1 == first + last - 2 * base and count < side**2:
            return side, base
    return None


def decode_folder(folder: Path, options: ReadOptions) -> NDArray:
    """The chosen views of a folder in the files' own type, alpha as the last channel, [V, U, C, H, W]."""
    cells, shape, name_of = arrange(folder, _only_field(folder, options.pattern), options)
    stored = grid.Grid(shape, {cell: file.path for cell, file in cells.items()})
    grid.check_holes(stored, name_of, folder, options.holes)
    if options.pattern is None and options.grid is None:
        _check_square(folder, stored)
    window = options.window(shape, folder)
    return grid.gather(stored, window, images.read_image, str, allocator(options.scratch))


def _only_field(folder: Path, pattern: str | None) -> list[NamedFile]:
    """The files of the only light field in a folder."""
    files = image_files(folder)
    if not files:
        raise FileError(f"{folder} must hold images", got="none", remedy=f"put in {', '.join(images.SUFFIXES)} files")
    if pattern is not None:
        fields = fields_of(files, [compiled(pattern)])
    else:
        fields = fields_of(files) or [field for field in numbered_fields(files) if _looks_like_views(field)]
    if not fields:
        got = f"{counted(len(files), 'image')} named like {files[0].name}"
        remedy = "give reader.pattern: index (row by row), or a regular expression with groups row and column"
        raise FileError(f"{folder} must hold views whose names say their rows and columns", got=got, remedy=remedy)
    if len(fields) > 1:
        got = " and ".join(field[0].path.name for field in fields[:2])
        raise FileError(f"{folder} must hold one light field", got=got, remedy="move one away, or give reader.pattern")
    return fields[0]


def _check_square(folder: Path, stored: grid.Grid[Path]) -> None:
    """Refuse a row of pictures, such as those of a moving camera, that seems a square grid because of its number.

    The next picture after the last view of a grid's row is the first view of the row below, which is far away: the view
    right below differs less. In a single row of pictures, the next picture differs less.
    """
    n_rows, n_columns = stored.shape
    cells = (n_rows // 2 - 1, n_columns - 1), (n_rows // 2, 0), (n_rows // 2, n_columns - 1)
    paths = [stored.cells.get(cell) for cell in cells]
    if None in paths or fields_of(stored.cells.values()):
        return
    last, first_below, last_below = (images.read_image(path).astype(np.float32) for path in paths if path)
    if not last.shape == first_below.shape == last_below.shape:
        return  # `gather` names the view that is unlike the others
    if np.abs(last_below - last).mean() > ROW_RATIO * np.abs(first_below - last).mean():
        got, n_views = f"{len(stored.cells)} pictures that look like one row", len(stored.cells)
        remedy = f"set reader.pattern=index and reader.grid=[1,{n_views}], or reader.grid=[{n_rows},{n_columns}]"
        raise FileError(f"{folder} must hold a square grid of views, row by row", got=got, remedy=remedy)


def positions_in_names(folder: Path, options: ReadOptions) -> NDArray[np.float64]:
    """Camera positions (v, u) of the chosen views by their names, in the names' own unit, NaN at holes, [V, U, 2]."""
    remedy = "give a CSV or JSON file as reader.positions"
    if not folder.is_dir():
        raise FileError(f"{folder} must be a folder for positions=names", got="a file", remedy=remedy)
    arrangement = arrange(folder, _only_field(folder, options.pattern), options)
    positions = np.full((*arrangement.shape, 2), np.nan)
    for cell, file in arrangement.cells.items():
        groups = file.match.groupdict()
        if "v" not in groups or "u" not in groups:
            expected = f"{file.path} must be named out_RR_CC_Y_X for positions=names"
            raise FileError(expected, got=file.path.name, remedy=remedy)
        positions[cell] = float(groups["v"]), float(groups["u"])
    return positions[options.window(arrangement.shape, folder)]


def encoding_of(path: Path, option: str, default: Encoding) -> Encoding:
    """The encoding of a file's samples: the option, else the file's header, else the default.

    Encodings stand in the sRGB and gAMA chunks of PNG, and in the EXIF of JPEG and TIFF.

    Args:
        path: A file, or a folder of views, whose first image counts for all.
        option: The option `encoding` of `lfref.read`; `file`: as the header says.
        default: Encoding for headers that say none, or an unknown one.
    """
    if option != "file":
        return encodings.parsed(option)
    files = image_files(path)[:1] if path.is_dir() else [path]
    if not files or images.format_of_head(images.read_head(files[0])) is None:
        return default
    with images.open_image(files[0]) as source:
        spec = source.spec()
    space = spec.get_string_attribute("oiio:ColorSpace").lower()
    gamma = spec.get_float_attribute("oiio:Gamma", 0.0)
    if space.startswith(("lin", "scene_linear")):
        return encodings.LINEAR
    if GAMMAS[0] <= gamma <= GAMMAS[1] and gamma != 1:
        return encodings.parsed(f"gamma:{gamma:.4g}")
    return encodings.SRGB if space.startswith("srgb") else default


def write_views(path: Path, views: NDArray, bits: int | None = None) -> None:
    """Write views, floating point, [V, U, C, H, W], as PNG images `NAME_RR_CC.png` named after the folder."""
    # A leading dot would hide the files from the reader.
    stem = path.absolute().name.lstrip(".") or "view"
    images.sample_type(path / "x.png", bits)
    named = ((f"{stem}_{row:02d}_{column:02d}.png", views[row, column]) for row, column in np.ndindex(views.shape[:2]))
    write_images(path, named, "views", bits)


def write_images(
    path: Path, named: Iterable[tuple[str, NDArray]], kind: str, bits: int | None, quality: int = images.QUALITY
) -> None:
    """Write named images [C, H, W] as a folder, which replaces an older one of its kind (`views` or `planes`)."""
    ownership.check_folder(path, kind)
    with atomic.replacing_folder(path) as partial, ThreadPoolExecutor(N_WRITERS) as pool:
        # Several images at a time: compression is most of the work, and releases the interpreter's lock.
        running = deque[Future[None]]()
        for name, image in named:
            if len(running) == N_WRITERS:
                running.popleft().result()
            channels_last = image.transpose(1, 2, 0)
            running.append(pool.submit(images.write_image, partial / name, channels_last, bits=bits, quality=quality))
        for future in running:
            future.result()
        ownership.write_mark(partial, kind, ownership.digests(partial, ownership.files_below(partial)))
