"""Folders of sub-aperture views: which file is the view at which row and column.

How names say it stands in `names`. Files that are only numbered through are taken for the views of a square grid, row
by row, where nothing speaks against it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError
from lfref.io import arrangements, decode, explain, grid, images, names

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
    return grid.gather(stored, selection.window(stored.shape, folder), images.read_image, str, selection.room)


def stored_grid(folder: Path, selection: grid.Selection) -> grid.Grid[Path]:
    """Which file is the view at which row and column; arguments and errors as `read_views`."""
    found = _one_field(folder, selection.pattern)
    cells, shape, name_of = arrangements.of(folder, found, selection)
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
    if arrangements.square(first, last, len(numbers)) is None or len(numbers) < FEWEST_NUMBERED:
        return False
    return min(decode.size(found[0].path)) < LARGEST_NUMBERED
