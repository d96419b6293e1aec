"""Multi-part EXR files: a light field has one part a view, a refocused stack has one part a focal plane.

View parts are named `view_RR_CC` (row and column from 0), plane parts `plane_NN`; a plane carries its `slope`, and
`alpha` and `convention` if it was written so. Channels are `Y` or `R G B`, then perhaps `weight`. Values are kept as
they are.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from lfref.errors import FileError
from lfref.geometry import FocalPlanes, planes_at_alphas
from lfref.io import grid, images

VIEW = re.compile(r"view_(\d+)_(\d+)")
PLANE = re.compile(r"plane_(\d+)")


def _view_name(cell: grid.Cell) -> str:
    return f"view_{cell[0]:02d}_{cell[1]:02d}"


def _plane_name(index: int) -> str:
    return f"plane_{index:02d}"


def _part_names(source: OpenImageIO.ImageInput) -> list[str]:
    """Names of all parts, in the order of the file."""
    names: list[str] = []
    while source.seek_subimage(len(names), 0):
        names.append(str(source.spec().getattribute("oiio:subimagename") or ""))
    source.geterror()  # the end of the file counts as an error
    return names


def _numbered(names: Iterable[str], pattern: re.Pattern[str]) -> dict[tuple[int, ...], int]:
    """Numbers in the part names that follow the pattern -> index of the part."""
    matches = ((index, pattern.fullmatch(name)) for index, name in enumerate(names))
    return {tuple(int(number) for number in match.groups()): index for index, match in matches if match}


def holds_views(path: Path) -> bool:
    """Whether an EXR file is a light field.

    Raises:
        FileError: The file cannot be read.
    """
    with images.open_image(path) as source:
        return bool(_numbered(_part_names(source), VIEW))


def write_views(path: Path, views: NDArray, bits: int | None = None) -> None:
    """Write a light field, one part a view.

    Args:
        path: The `.exr` file to write.
        views: Floating point; 2 or 4 channels: the last is a weight, [V, U, C, H, W].
        bits: 32 (default) or 16 (half).

    Raises:
        InputError: NaN or infinity, a value beyond half, or another depth or channel count.
        FileError: The folder or the disk refuses.
    """
    cells = np.ndindex(views.shape[:2])
    parts = [images.Part(views[cell].transpose(1, 2, 0), _view_name((cell[0], cell[1]))) for cell in cells]
    images.write_parts(path, parts, bits)


def read_views(path: Path, selection: grid.Selection) -> NDArray:
    """The chosen views of a light field.

    Args:
        path: The file.
        selection: Views to keep; None keeps all.

    Returns:
        Samples, float32, [V, U, C, H, W].

    Raises:
        FileError: The file cannot be read, a view is missing, or views differ in size.
        InputError: The window of views leaves the grid.
    """
    with images.open_image(path) as source:
        parts = _numbered(_part_names(source), VIEW)
        cells = {(row, column): part for (row, column), part in parts.items()}
        if not cells:
            raise FileError(f"{path} must hold parts named view_RR_CC", remedy="write it with lfref.write")
        stored = grid.Grid(grid.extent(cells), cells)
        grid.check_holes(stored, _view_name, path, selection.holes)
        window = selection.window(stored.shape, path)
        return grid.gather(
            stored,
            window,
            lambda part: images.read_part(source, path, part),
            lambda part: f"{path}:{part}",
            selection.room,
        )


def write_planes(path: Path, stack: NDArray, planes: FocalPlanes, bits: int | None = None) -> None:
    """Write a refocused stack, one part a plane.

    Args:
        path: The `.exr` file to write.
        stack: Floating point, [N, C, H, W].
        planes: The N planes.
        bits: 32 (default) or 16 (half).

    Raises:
        InputError: NaN or infinity, a value beyond half, or another depth or channel count.
        FileError: The folder or the disk refuses.
    """
    # As text: an EXR attribute that is a number keeps 24 bits of it.
    attributes: list[dict[str, str | float]] = [{"slope": repr(slope)} for slope in planes.values]
    for said, alpha in zip(attributes, planes.alphas or (), strict=False):
        said |= {"alpha": repr(alpha), "convention": str(planes.convention)}
    parts = [
        images.Part(plane.transpose(1, 2, 0), _plane_name(index), said)
        for index, (plane, said) in enumerate(zip(stack, attributes, strict=True))
    ]
    images.write_parts(path, parts, bits)


def read_planes(path: Path) -> tuple[NDArray, FocalPlanes]:
    """A refocused stack and its planes.

    Args:
        path: The file.

    Returns:
        Stack, float32, [N, C, H, W], and its planes.

    Raises:
        FileError: The file cannot be read, a plane is missing or does not say its slope, or planes differ in size.
    """
    with images.open_image(path) as source:
        parts = _numbered(_part_names(source), PLANE)
        cells = {(0, index): part for (index,), part in parts.items()}
        if not cells:
            raise FileError(f"{path} must hold parts named plane_NN", remedy="write it with lfref.io.write.write_stack")
        stored = grid.Grid(grid.extent(cells), cells)
        grid.check_holes(stored, lambda cell: _plane_name(cell[1]), path, allowed=False)
        n_planes = len(cells)
        planes = _planes([source.spec(cells[0, index]) for index in range(n_planes)], path)
        window = slice(0, 1), slice(0, n_planes)
        stack = grid.gather(
            stored, window, lambda part: images.read_part(source, path, part), lambda part: f"{path}:{part}"
        )
    return stack[0], planes


def _planes(specs: list[OpenImageIO.ImageSpec], path: Path) -> FocalPlanes:
    """The planes that the parts say they are."""
    convention = specs[0].getattribute("convention")
    # Slopes of lfref 0.1 were numbers, and so rounded: its alphas say the planes.
    has_exact_slopes = all(isinstance(spec.getattribute("slope"), str) for spec in specs)
    said = [spec.getattribute("slope" if has_exact_slopes else "alpha") for spec in specs]
    try:
        numbers = [float(str(value)) for value in said]
        if has_exact_slopes:
            return FocalPlanes(numbers, convention)
        return planes_at_alphas(numbers, str(convention))
    except ValueError as error:
        raise FileError(f"{path} must say the slope of each plane", got=error, remedy="write it again") from error
