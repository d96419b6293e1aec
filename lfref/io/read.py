"""Reading light fields and refocused stacks, whatever form they are stored in.

A folder is read as sub-aperture views, a picture as a lenslet image, an EXR file as one part a view, an array as it is.
Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import encoding as encodings
from lfref.encoding import Encoding
from lfref.errors import FileError, InputError
from lfref.geometry import FocalPlanes
from lfref.io import cameras, exr, field_formats, images, metadata, options, view_folders
from lfref.io import grid as grids
from lfref.io import options as described
from lfref.io import scratch as scratches
from lfref.io.scratch import Room
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
    lenslet: int = grids.LENSLET,
    pitch: float | Sequence[float] | None = None,
    offset: Sequence[float] | None = None,
    rotation: float | None = None,
    lattice: str | None = None,
    white: str | Path | None = None,
    size: tuple[int, int] | None = None,
    grid: tuple[int, int] | None = None,
    holes: bool | None = None,
    axes: str | None = None,
    variable: str | None = None,
    positions: str | Path | None = None,
    spacing: tuple[float, float] | None = None,
    encoding: str = "file",
    scratch: str | Path | None = None,
) -> LightField:
    """Read a light field: an ESLF image, a folder of views, or a multi-part EXR file.

    Args:
        path: File or folder.
        views: Rows and columns of views to keep, or one number for both; None keeps all, and 7x7 of an ESLF.
        start: First row and column to keep, from 0, as stored; None keeps the centre, which for 7 of the 14
            views of an ESLF starts at 4 (3 is as central).
        reverse_v: Whether the rows of views run upwards in the file.
        reverse_u: Whether the columns of views run to the left in the file.
        pattern: How the files of a folder are named: `row_column`, `column_row`, `index` (numbered row by row), or a
            regular expression with the named groups `row` and `column`, or `index`; None knows what `names` says.
        lenslet: Views along each axis of an ESLF image, whose lenslets are aligned with its pixels.
        pitch: Of lenslets that are not aligned: pixels between neighbours, also a fraction, or [rows, columns].
        offset: Their centre [y, x] of any lenslet, from the middle of the first pixel; None: what dark borders of
            lenslets show, else half a pitch from the corner.
        rotation: Degrees by which their rows are turned, above 0 where they fall to the right.
        lattice: `square` or `hexagonal` (every other row half a pitch further); None: square, or what `white` shows.
        white: A white image of the camera: it shows the lenslets, and what is divided by it is bright throughout.
        size: Height and width in pixels to keep of each view, from its top left corner; None keeps all.
        grid: Rows and columns of views that are numbered through; None: a square.
        holes: Whether views may be missing; None: only where that seems to be on purpose (a cross, a diagonal).
        axes: What the axes of an array are, as `vuhwc`: view row and column, pixel row and column, channel, or `n` for
            views row by row; None: what its shape leaves no doubt about.
        variable: Which array of a file of several; None: the only one that may be a light field, or `LF`.
        positions: Where the cameras stood: a CSV or JSON file as `positions` reads it, or `names` for the names of a
            Stanford gantry's files; None: on an even grid.
        spacing: View steps from row to row and from column to column, both above 0, if they are not alike.
        encoding: How samples stand for light: `linear`, `srgb`, `gamma:EXPONENT`; `file`: as the file says, else sRGB
            for integers and linear for floating point; `none` leaves them as they are, as the paper does.
        scratch: A folder for views that are larger than memory: they lie in a file there, which has no name and is gone
            with them. Folders of views and EXR files are never in memory as a whole; other forms are, as samples.

    Returns:
        The light field, float32, [V, U, C, H, W] contiguous with C 1 or 3; linear light (unless `encoding` is `none`)
        in [0, 1], and beyond where files of floating point are. Alpha becomes the weight, which is 0 where views are
        missing. The name is that of the path without suffix; the metadata say `path`, `format` (`eslf`, `folder`,
        `exr`, `array`), `bits` (`8`, `16`, `float`), `encoding`, `missing` if views are, `cut from` if `size` leaves
        something out, and what else the files say (see `metadata`).

    Raises:
        FileError: A file is missing, damaged, or not what it should be.
        InputError: Options do not fit the file, or do not concern its form.

    Example:
        >>> path = lfref.write("capture", lfref.LightField(torch.rand(3, 3, 3, 24, 32)))  # a folder of PNG views
        >>> lfref.read(path).views.shape
        torch.Size([3, 3, 3, 24, 32])
    """
    options.check(views=views, start=start, reverse_v=reverse_v, reverse_u=reverse_u, pattern=pattern, lenslet=lenslet)
    options.check(size=size, grid=grid, holes=holes, axes=axes, variable=variable, positions=positions, spacing=spacing)
    options.check(rotation=rotation, white=white, encoding=encoding, scratch=scratch)
    path = Path(path)
    kept = (views, views) if isinstance(views, int) else views
    lenslets = described.parsed(pitch, offset, rotation, lattice, white)
    room = scratches.room(None if scratch is None else Path(scratch))
    selection = grids.Selection(
        kept, start, pattern, lenslet, grid, holes, axes, variable, lenslets=lenslets, encoding=encoding, room=room
    )
    form = field_formats.of(path)
    field_formats.check_options(path, form, selection)
    whole = form.read_views(path, selection)
    samples = _cut(whole, size, path)
    present = _present(samples)
    coded, turned = _encoding(encoding, path, whole), _Turned(reverse_v, reverse_u)
    said = metadata.of(path) | {"path": str(path), "format": form.name} | _told(whole, samples, present, coded)
    field = _light_field(turned.samples(samples), path, said, coded, room)
    places = cameras.of(path, selection, present, positions, spacing)
    return field if places is None else replace(field, positions=torch.from_numpy(turned.places(places)))


class _Turned(NamedTuple):
    """Which axes of the views run the other way in the file."""

    v: bool
    u: bool

    def samples(self, stored: NDArray) -> NDArray:
        """The views as we count them, [V, U, ...]."""
        return stored[:: -1 if self.v else 1, :: -1 if self.u else 1]

    def places(self, stored: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions, which grow with rows and columns whichever way round those stand, [V, U, 2]."""
        return self.samples(stored) * (-1 if self.v else 1, -1 if self.u else 1)


def _told(whole: NDArray, samples: NDArray, present: NDArray[np.bool_], coded: Encoding) -> dict[str, str]:
    """Metadata of the samples that are kept of whole views."""
    said = {"bits": BITS[samples.dtype.name], "encoding": str(coded)}
    if not present.all():
        said["missing"] = f"{(~present).sum()} of {present.size} views"
    if whole.shape != samples.shape:
        said["cut from"] = f"{whole.shape[-2]}x{whole.shape[-1]} pixels"
    return said


def _present(samples: NDArray) -> NDArray[np.bool_]:
    """Which views have any weight, [V, U]."""
    if samples.shape[2] % 2:
        return np.ones(samples.shape[:2], bool)
    return np.asarray(samples[:, :, -1].any(axis=(2, 3)))


def _cut(samples: NDArray, size: tuple[int, int] | None, path: Path) -> NDArray:
    """The top left corner of each view."""
    height, width = samples.shape[-2:]
    rows, columns = size or (height, width)
    if not (1 <= rows <= height and 1 <= columns <= width):
        raise InputError(f"size must lie within the {height}x{width} views of {path}", got=f"{rows}x{columns}")
    return samples[..., :rows, :columns]


def _encoding(asked: str, path: Path, samples: NDArray) -> Encoding:
    """The encoding asked for, or what the file says, or what such samples usually have."""
    if asked != "file":
        return encodings.parsed(asked)
    usual = encodings.LINEAR if samples.dtype.kind == "f" else encodings.SRGB
    return view_folders.encoding_of(path) or usual


def _light_field(samples: NDArray, path: Path, metadata: dict[str, str], coded: Encoding, room: Room) -> LightField:
    """The light field whose second or fourth channel, if there is one, is the weight."""
    name = path.absolute().name if path.is_dir() else path.stem
    n_colours = samples.shape[2] - 1 + samples.shape[2] % 2
    weight = _made(samples[:, :, n_colours:], images.to_float, room) if n_colours < samples.shape[2] else None
    views = _made(samples[:, :, :n_colours], lambda view: images.decoded(view, coded), room)
    return LightField(views, name, weight, metadata, is_linear=coded.is_known)


def _made(samples: NDArray, make: Callable[[NDArray], NDArray], room: Room) -> Tensor:
    """What is made of each view, float32."""
    if room is np.zeros:
        return torch.from_numpy(make(samples))
    made = room(samples.shape, np.float32)
    for cell in np.ndindex(samples.shape[:2]):
        made[cell] = make(samples[cell])
    return torch.from_numpy(made)


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
    return torch.from_numpy(images.to_float(stack)), planes


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
    if field_formats.is_field(path):
        return [path]
    found = sorted(child for child in path.iterdir() if field_formats.is_field(child)) if path.is_dir() else []
    if not found:
        got, remedy = "none" if path.exists() else "no such file or folder", "check the path"
        raise FileError(f"{path} must hold light fields: {field_formats.TITLES}", got=got, remedy=remedy)
    return found
