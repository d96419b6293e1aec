"""Multi-part EXR files: a light field has one part a view, a refocused stack has one part a focal plane.

View parts are named `view_RR_CC` (row and column from 0), plane parts `plane_NN`. A plane has the attribute `slope`,
and `alpha` and `convention` if it was written as an alpha. Channels are `Y` or `R G B`, then perhaps `weight`. Values
are kept as they are.
"""

import re
from pathlib import Path

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from lfref.errors import FileError, first_line
from lfref.geometry import FocalPlanes
from lfref.io import images, samples
from lfref.io.samples import ReadOptions, Samples

VIEW = re.compile(r"view_(\d+)_(\d+)")
PLANE = re.compile(r"plane_(\d+)")


def _numbered_parts(source: OpenImageIO.ImageInput, pattern: re.Pattern[str]) -> dict[tuple[int, ...], int]:
    """Numbers in part names that match a pattern -> index of the part."""
    numbered, index = {}, 0
    while source.seek_subimage(index, 0):
        name = str(source.spec().getattribute("oiio:subimagename") or "")
        if match := pattern.fullmatch(name):
            numbered[tuple(int(number) for number in match.groups())] = index
        index += 1
    source.geterror()  # the end of the file counts as an error
    return numbered


def holds_views(path: Path) -> bool:
    """Whether an EXR file is a light field."""
    with images.open_image(path) as source:
        return bool(_numbered_parts(source, VIEW))


def write_views(path: Path, views: NDArray, bits: int | None = None) -> None:
    """Write views, floating point, [V, U, C, H, W], one part a view; 32 bits or 16 (half)."""
    parts = [
        images.Part(views[row, column].transpose(1, 2, 0), f"view_{row:02d}_{column:02d}")
        for row, column in np.ndindex(views.shape[:2])
    ]
    images.write_parts(path, parts, bits)


def decode_views(path: Path, options: ReadOptions) -> Samples:
    """The chosen views of a light field, float32."""
    with images.open_image(path) as source:
        cells = {(row, column): part for (row, column), part in _numbered_parts(source, VIEW).items()}
        if not cells:
            raise FileError(f"{path} must hold parts named view_RR_CC", remedy="write it with lfref.write")
        shape = samples.extent(cells)
        samples.check_holes(cells, shape, path, options.holes)
        window = options.window(shape, path)
        colours, weight = samples.gather(cells, window, lambda part: images.read_part(source, path, part))
    return Samples(colours, weight, images.encoding_of(path, options.encoding, images.usual_encoding(colours)))


def write_planes(path: Path, stack: NDArray, planes: FocalPlanes, bits: int | None = None) -> None:
    """Write a refocused stack, floating point, [N, C, H, W], one part a plane; 32 bits or 16 (half)."""
    parts = []
    for index, (picture, slope) in enumerate(zip(stack, planes.values, strict=True)):
        # Attributes are text, since a number in EXR keeps only 24 bits.
        attributes: dict[str, str | float] = {"slope": repr(slope)}
        if planes.alphas is not None:
            attributes |= {"alpha": repr(planes.alphas[index]), "convention": str(planes.convention)}
        parts.append(images.Part(picture.transpose(1, 2, 0), f"plane_{index:02d}", attributes))
    images.write_parts(path, parts, bits)


def read_planes(path: Path) -> tuple[NDArray, FocalPlanes]:
    """A refocused stack, float32, [N, C, H, W], and its planes."""
    with images.open_image(path) as source:
        parts = [part for _, part in sorted(_numbered_parts(source, PLANE).items())]
        try:
            stack = np.stack([images.read_part(source, path, part).transpose(2, 0, 1) for part in parts])
            specs = [source.spec(part) for part in parts]
            slopes = [float(spec.getattribute("slope")) for spec in specs]
            return stack, FocalPlanes(slopes, specs[0].getattribute("convention"))
        except (TypeError, ValueError) as error:
            expected = f"{path} must hold parts named plane_NN, each with its slope"
            raise FileError(expected, got=first_line(error), remedy="write it with write_stack") from error
