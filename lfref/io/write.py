"""Writing light fields and refocused stacks, all of it or nothing: a multi-part EXR file, or a folder of images.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import encoding as encodings
from lfref.encoding import Encoding
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import exr, field_formats, images, view_folders
from lfref.lightfield import LightField

Writer = TypeVar("Writer")


def write(path: str | Path, field: LightField, *, bits: int | None = None) -> Path:
    """Write a light field so that `read` gives it back, exact but for the rounding to these bits.

    Args:
        path: A name in `.exr` for a multi-part EXR file; a name without suffix for a folder of PNG images named
            `NAME_RR_CC.png`, row and column from 0, encoded for a screen (sRGB) if the light field is linear, clipped
            to [0, 1]. The weight is the last channel.
        field: The light field, C 1 or 3. Its name is not kept: `read` names a light field after its path.
        bits: 8 (default) or 16 for a folder; 32 (default) or 16 (half) for EXR.

    Returns:
        The path.

    Raises:
        InputError: NaN or infinity, or a suffix, depth or number of channels that cannot be written.
        FileError: The disk refuses, or the path holds anything but such a light field as `write` left it.

    Example:
        >>> field = lfref.LightField(torch.rand(3, 3, 3, 24, 32))
        >>> path = lfref.write("capture.exr", field)
        >>> torch.equal(lfref.read(path).views, field.views)
        True
    """
    views = _stored(field.views, Path(path), field.picture_encoding)
    samples = views if field.weight is None else torch.cat([views, field.weight.to(views)], dim=2)
    _writer(VIEW_WRITERS, Path(path))(Path(path), _array(samples, field.views.shape[2]), bits)
    return Path(path)


def write_stack(
    path: str | Path,
    stack: Tensor,
    planes: FocalPlanes,
    *,
    bits: int | None = None,
    encoding: Encoding = encodings.SRGB,
) -> Path:
    """Write a refocused stack.

    Args:
        path: A name in `.exr` for a multi-part EXR file, which `read_stack` reads; a name without suffix for a
            folder of PNG images named `plane_00_slope_-7_alpha_0.125.png`, which clip to [0, 1].
        stack: Refocused images, floating point, [N, C, H, W] with C 1 or 3.
        planes: The N planes.
        bits: 8 (default) or 16 for a folder; 32 (default) or 16 (half) for EXR.
        encoding: What pictures are encoded by; EXR files hold the stack as it is.

    Returns:
        The path.

    Raises:
        InputError: Another number of planes, NaN or infinity, or a suffix, depth or number of channels that
            cannot be written.
        FileError: The disk refuses, or the path holds anything but such a stack as `write_stack` left it.
    """
    if stack.ndim != 4 or len(stack) != len(planes):
        raise InputError(f"stack must be [N, C, H, W] with N = {len(planes)} planes", got=f"shape {list(stack.shape)}")
    shown = _stored(stack, Path(path), encoding)
    _writer(STACK_WRITERS, Path(path))(Path(path), _array(shown, stack.shape[1]), planes, bits)
    return Path(path)


def _stored(light: Tensor, path: Path, encoding: Encoding) -> Tensor:
    """Light as the file shall hold it: pictures, which a folder consists of, are encoded."""
    return light if path.suffix else encoding.encode(light)


def write_pictures(
    path: str | Path,
    pictures: Iterable[NDArray],
    planes: FocalPlanes,
    *,
    suffix: str = ".png",
    bits: int | None = None,
    quality: int = images.QUALITY,
) -> Path:
    """Write the planes of a stack as pictures, as they are to be shown.

    Args:
        path: A folder; its files are named `plane_00_slope_-7_alpha_0.125.png`, or without alpha where none reaches.
        pictures: What is shown, floating point, clipped to [0, 1], N times [C, H, W] with C 1 or 3.
        planes: The N planes.
        suffix: One of `images.DEPTHS`.
        bits: As the format has them.
        quality: Of JPEG and AVIF, from 1 to 100.

    Returns:
        The path.

    Raises:
        InputError: NaN or infinity, or a depth, quality or number of channels that cannot be written.
        FileError: The disk refuses, or the path holds anything but such pictures as lfref left them.
    """
    images.sample_type(Path(path) / f"x{suffix}", bits)
    names = (re.sub(r"[, ]+", "_", title) for title in planes.titles)
    files = (f"plane_{n:02d}_{name}{suffix}" for n, name in enumerate(names))
    view_folders.write_images(Path(path), zip(files, pictures, strict=True), "planes", bits, quality)
    return Path(path)


def _array(samples: Tensor, n_colours: int) -> NDArray:
    """Samples as float32 in numpy."""
    if n_colours not in (1, 3):
        raise InputError("only 1 or 3 channels can be written", got=n_colours)
    return samples.detach().to("cpu", torch.float32).numpy()


def _writer(writers: dict[str, Writer], path: Path) -> Writer:
    """What writes a path of this suffix."""
    if path.suffix.lower() not in writers:
        known = " or ".join(filter(None, writers))
        raise InputError(f"{path} must end in {known}, or have no suffix for a folder", remedy="choose another name")
    return writers[path.suffix.lower()]


def _write_stack_folder(path: Path, stack: NDArray, planes: FocalPlanes, bits: int | None) -> None:
    write_pictures(path, stack, planes, bits=bits)


VIEW_WRITERS = {
    suffix: form.write_views
    for form in (field_formats.FOLDER, *field_formats.FORMATS)
    if form.write_views is not None
    for suffix in form.suffixes
}
"""Suffix of a path -> (path, views, bits) -> None."""
STACK_WRITERS = {"": _write_stack_folder, ".exr": exr.write_planes}
"""Suffix of a path -> (path, stack, planes, bits) -> None."""
