"""Writing light fields and refocused stacks, all of it or nothing: a multi-part EXR file, or a folder of images.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import encoding as encodings
from lfref.encoding import Encoding
from lfref.errors import FileError, InputError
from lfref.geometry import FocalPlanes
from lfref.io import exr, images, view_folders
from lfref.lightfield import LightField

SUFFIXES = ("", ".exr")
"""Suffixes of paths that light fields and stacks are written to; "" for a folder."""


def write(path: str | Path, field: LightField, *, bits: int | None = None, overwrite: bool = False) -> Path:
    """Write a light field so that `read` gives it back, exact up to the rounding to these bits; returns the path.

    Samples that are no light (`is_linear` false) are kept as they are: read them with `encoding="none"`.

    Args:
        path: A name with the suffix `.exr` for a multi-part EXR file; a name without suffix for a folder of PNG images
            named `NAME_RR_CC.png`, row and column from 0. PNG images are encoded for a screen (sRGB) if the light field
            is linear, and clipped to [0, 1]. The weight is the last channel.
        field: The light field, C 1 or 3, on an even grid. Its name is not kept: `read` names it after its path.
        bits: Bits per sample: 8 (default) or 16 for a folder; 32 (default) or 16 (half) for EXR.
        overwrite: Write over files of equal names; other files in a folder stay.

    Example:
        >>> field = lfref.LightField(torch.rand(3, 3, 3, 24, 32))
        >>> path = lfref.write("capture.exr", field)
        >>> torch.equal(lfref.read(path).views, field.views)
        True
    """
    path, views = Path(path), field.views
    _check(path, views, overwrite)
    if field.positions is not None:
        raise InputError("only views of an even grid can be written", got="positions of cameras")
    # A folder consists of pictures, which are encoded.
    samples = views if path.suffix else field.picture_encoding.encode(views)
    if field.weight is not None:
        samples = torch.cat([samples, field.weight.to(samples)], dim=2)
    write_views = exr.write_views if path.suffix else view_folders.write_views
    write_views(path, samples.detach().to("cpu", torch.float32).numpy(), bits)
    return path


def write_stack(
    path: str | Path,
    stack: Tensor,
    planes: FocalPlanes,
    *,
    bits: int | None = None,
    encoding: Encoding = encodings.SRGB,
    overwrite: bool = False,
) -> Path:
    """Write a refocused stack [N, C, H, W], C 1 or 3, as an EXR file (C also above 4) or as a folder of pictures."""
    path = Path(path)
    _check(path, stack, overwrite)
    samples = (stack if path.suffix else encoding.encode(stack)).detach().to("cpu", torch.float32).numpy()
    if path.suffix:
        exr.write_planes(path, samples, planes, bits)
    else:
        write_pictures(path, samples, planes, bits=bits)
    return path


def write_pictures(
    path: str | Path,
    pictures: Iterable[NDArray],
    planes: FocalPlanes,
    *,
    suffix: str = ".png",
    bits: int | None = None,
    quality: int = images.QUALITY,
) -> Path:
    """Write pictures [C, H, W], encoded for the screen, into a folder as `plane_00_slope_-7_alpha_0.125.png`."""
    names = (re.sub(r"[, ]+", "_", title) for title in planes.titles)
    files = (f"plane_{n:02d}_{name}{suffix}" for n, name in enumerate(names))
    view_folders.write_images(Path(path), zip(files, pictures, strict=True), bits, quality)
    return Path(path)


def _check(path: Path, light: Tensor, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise FileError(f"{path} must be new", got="one that is there", remedy="choose another, or overwrite=True")
    if path.suffix.lower() not in SUFFIXES or light.shape[-3] not in (1, 3, *range(5, 1000 if path.suffix else 0)):
        expected = f"{path} must end in .exr or be a folder, and get 1 or 3 channels; EXR also more than 4"
        raise InputError(expected, got=light.shape[-3])
