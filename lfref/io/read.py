"""Reading light fields and refocused stacks, whatever form they are stored in.

A folder is read as sub-aperture views, a PNG or TIFF file as an ESLF image, an EXR file as one part a view.
Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import FileError, InputError
from lfref.geometry import FocalPlanes
from lfref.io import exr, formats, grid, images
from lfref.io.lenslets import options as described
from lfref.lightfield import LightField

BITS = {"uint8": "8", "uint16": "16", "float32": "float"}


def read(
    path: str | Path,
    *,
    views: int | tuple[int, int] | None = None,
    start: int | None = None,
    reverse_v: bool = False,
    reverse_u: bool = False,
    pattern: str | None = None,
    lenslet: int = 14,
    pitch: float | Sequence[float] | None = None,
    offset: Sequence[float] | None = None,
    rotation: float | None = None,
    lattice: str | None = None,
    white: str | Path | None = None,
    size: tuple[int, int] | None = None,
) -> LightField:
    """Read a light field: an ESLF image, a folder of views, or a multi-part EXR file.

    Args:
        path: File or folder.
        views: Rows and columns of views to keep, or one number for both; None keeps all, and 7x7 of an ESLF.
        start: First row and column to keep, from 0, as stored; None keeps the centre, which for 7 of the 14
            views of an ESLF starts at 4 (3 is as central).
        reverse_v: Whether the rows of views run upwards in the file.
        reverse_u: Whether the columns of views run to the left in the file.
        pattern: Regular expression for the file names of a folder, with the named groups `row` and `column`, or
            `index` for a square grid in row-major order; None knows HCI, Stanford gantry and `NAME_RR_CC`.
        lenslet: Views along each axis of an ESLF image, whose lenslets are aligned with its pixels.
        pitch: Of lenslets that are not aligned: pixels between neighbours, also a fraction, or [rows, columns].
        offset: Their centre [y, x] of any lenslet, from the middle of the first pixel; None: what dark borders of
            lenslets show, else half a pitch from the corner.
        rotation: Degrees by which their rows are turned, above 0 where they fall to the right.
        lattice: `square` or `hexagonal` (every other row half a pitch further); None: square, or what `white` shows.
        white: A white image of the camera: it shows the lenslets, and what is divided by it is bright throughout.
        size: Height and width in pixels to keep of each view, from its top left corner; None keeps all.

    Returns:
        The light field, float32, [V, U, C, H, W] contiguous with C 1 or 3; radiance in [0, 1], but values of EXR
        files as they are. Alpha becomes the weight. The name is that of the path without suffix; the metadata say
        `path`, `format` (`eslf`, `folder`, `exr`) and `bits` (`8`, `16`, `float`).

    Raises:
        FileError: A file is missing, damaged, or not what it should be.
        InputError: Views, size or pattern do not fit the file.

    Example:
        >>> path = lfref.write("capture", lfref.LightField(torch.rand(3, 3, 3, 24, 32)))  # a folder of PNG views
        >>> lfref.read(path).views.shape
        torch.Size([3, 3, 3, 24, 32])
    """
    path = Path(path)
    form = formats.of(path)
    lenslets = described.parsed(pitch, offset, rotation, lattice, white)
    wanted = (views, views) if isinstance(views, int) else views
    selection = grid.Selection(wanted, start, pattern, lenslet, lenslets=lenslets)
    samples = _cut(form.read_views(path, selection), size, path)
    samples = samples[:: -1 if reverse_v else 1, :: -1 if reverse_u else 1]
    metadata = {"path": str(path), "format": form.name, "bits": BITS[samples.dtype.name]}
    name = path.absolute().name if path.is_dir() else path.stem
    return _light_field(samples, name, metadata)


def _cut(samples: NDArray, size: tuple[int, int] | None, path: Path) -> NDArray:
    """The top left corner of each view."""
    height, width = samples.shape[-2:]
    rows, columns = size or (height, width)
    if not (1 <= rows <= height and 1 <= columns <= width):
        raise InputError(f"size must lie within the {height}x{width} views of {path}", got=f"{rows}x{columns}")
    return samples[..., :rows, :columns]


def _light_field(samples: NDArray, name: str, metadata: dict[str, str]) -> LightField:
    """The light field whose second or fourth channel, if there is one, is the weight."""
    n_colours = samples.shape[2] - 1 + samples.shape[2] % 2
    colours, weight = samples[:, :, :n_colours], samples[:, :, n_colours:]
    return LightField(_tensor(colours), name, _tensor(weight) if weight.size else None, metadata)


def _tensor(samples: NDArray) -> Tensor:
    return torch.from_numpy(images.to_float(samples))


def read_stack(path: str | Path) -> tuple[Tensor, FocalPlanes]:
    """Read a refocused stack that `write_stack` wrote as an EXR file.

    Args:
        path: The file.

    Returns:
        Stack, float32, [N, C, H, W], and its N planes.

    Raises:
        FileError: The file is missing, damaged or not such a stack.
    """
    stack, planes = exr.read_planes(Path(path))
    return _tensor(stack), planes


def find(path: str | Path) -> list[Path]:
    """The light fields of a data folder.

    Args:
        path: A light field, or a folder whose files and folders are light fields.

    Returns:
        The path itself if it is one light field, else those right below it, sorted.

    Raises:
        FileError: There is none.
    """
    path = Path(path)
    if formats.is_field(path):
        return [path]
    found = sorted(child for child in path.iterdir() if formats.is_field(child)) if path.is_dir() else []
    if not found:
        got, remedy = "none" if path.exists() else "no such file or folder", "check the path"
        raise FileError(f"{path} must hold light fields: {formats.TITLES}", got=got, remedy=remedy)
    return found
