"""Writing light fields and refocused stacks, all of it or nothing: a multi-part EXR file, or a folder of PNG images.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import FileError, InputError
from lfref.geometry import FocalPlanes
from lfref.io import atomic, encode, exr, images
from lfref.lightfield import LightField

Writer = TypeVar("Writer")

OUR_VIEW = re.compile(r".+_\d+_\d+\.png")
OUR_PLANE = re.compile(r"plane_\d+_(alpha|slope)_.+\.png")


def write(path: str | Path, field: LightField, *, bits: int | None = None) -> Path:
    """Write a light field so that `read` gives it back, exact but for the rounding to these bits.

    Args:
        path: A name in `.exr` for a multi-part EXR file; a name without suffix for a folder of PNG images named
            `NAME_RR_CC.png`, row and column from 0, which clip to [0, 1]. The weight is the last channel.
        field: The light field, C 1 or 3. Its name is not kept: `read` names a light field after its path.
        bits: 8 (default) or 16 for a folder; 32 (default) or 16 (half) for EXR.

    Returns:
        The path.

    Raises:
        InputError: NaN or infinity, or a suffix, depth or number of channels that cannot be written.
        FileError: The disk refuses, or the path is a folder that holds anything but such a light field.
    """
    samples = field.views if field.weight is None else torch.cat([field.views, field.weight.to(field.views)], dim=2)
    return _writer(VIEW_WRITERS, Path(path))(Path(path), _array(samples, field.views.shape[2]), bits)


def write_stack(path: str | Path, stack: Tensor, planes: FocalPlanes, *, bits: int | None = None) -> Path:
    """Write a refocused stack.

    Args:
        path: A name in `.exr` for a multi-part EXR file, which `read_stack` reads; a name without suffix for a
            folder of PNG images named `plane_00_alpha_0.125.png` or `plane_00_slope_-7.png`, which clip to [0, 1].
        stack: Refocused images, floating point, [N, C, H, W] with C 1 or 3.
        planes: The N planes.
        bits: 8 (default) or 16 for a folder; 32 (default) or 16 (half) for EXR.

    Returns:
        The path.

    Raises:
        InputError: Another number of planes, NaN or infinity, or a suffix, depth or number of channels that
            cannot be written.
        FileError: The disk refuses, or the path is a folder that holds anything but such a stack.
    """
    if stack.ndim != 4 or len(stack) != len(planes):
        raise InputError(f"stack must be [N, C, H, W] with N = {len(planes)} planes", got=f"shape {list(stack.shape)}")
    return _writer(STACK_WRITERS, Path(path))(Path(path), _array(stack, stack.shape[1]), planes, bits)


def _array(samples: Tensor, n_colours: int) -> NDArray:
    """Samples as float32 in numpy."""
    if n_colours not in (1, 3):
        raise InputError("only 1 or 3 channels can be written", got=n_colours)
    return samples.detach().to("cpu", torch.float32).numpy()


def _writer(writers: dict[str, Writer], path: Path) -> Writer:
    """What writes a path of this suffix."""
    if path.suffix.lower() not in writers:
        raise InputError(f"{path} must end in .exr, or have no suffix for a folder", remedy="choose another name")
    return writers[path.suffix.lower()]


def _write_view_file(path: Path, views: NDArray, bits: int | None) -> Path:
    exr.write_views(path, views, bits)
    return path


def _write_view_folder(path: Path, views: NDArray, bits: int | None) -> Path:
    # A leading dot would hide the files from the reader.
    stem = path.absolute().name.lstrip(".") or "view"
    named = ((f"{stem}_{row:02d}_{column:02d}.png", views[row, column]) for row, column in np.ndindex(views.shape[:2]))
    return _write_folder(path, named, OUR_VIEW, bits)


def _write_stack_file(path: Path, stack: NDArray, planes: FocalPlanes, bits: int | None) -> Path:
    exr.write_planes(path, stack, planes, bits)
    return path


def _write_stack_folder(path: Path, stack: NDArray, planes: FocalPlanes, bits: int | None) -> Path:
    labels = (label.replace(" ", "_") for label in planes.labels)
    named = ((f"plane_{n:02d}_{label}.png", plane) for n, (label, plane) in enumerate(zip(labels, stack, strict=True)))
    return _write_folder(path, named, OUR_PLANE, bits)


VIEW_WRITERS: dict[str, Callable[[Path, NDArray, int | None], Path]] = {
    "": _write_view_folder,
    ".exr": _write_view_file,
}
STACK_WRITERS: dict[str, Callable[[Path, NDArray, FocalPlanes, int | None], Path]] = {
    "": _write_stack_folder,
    ".exr": _write_stack_file,
}


def _write_folder(path: Path, named: Iterable[tuple[str, NDArray]], ours: re.Pattern[str], bits: int | None) -> Path:
    """Write images [C, H, W] as PNG files of a folder, which takes the place of an older one of its kind."""
    encode.sample_type(path / "x.png", bits)
    _check_replaceable(path, ours)
    with atomic.replacing_folder(path) as partial:
        for name, image in named:
            images.write_image(partial / name, image.transpose(1, 2, 0), bits=bits)
    return path


def _check_replaceable(path: Path, ours: re.Pattern[str]) -> None:
    """Refuse to replace a folder that holds anything that we did not write."""
    foreign = [child.name for child in path.iterdir() if not ours.fullmatch(child.name)] if path.is_dir() else []
    if foreign:
        expected = f"{path} must be empty or hold only an older one of its kind to be replaced"
        raise FileError(expected, got=f"also {sorted(foreign)[0]}", remedy="choose another folder")
