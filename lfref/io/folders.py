"""Writing folders of images, all of it or nothing, in the place of nothing but an older one of ours.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.io import atomic, encode, images, marks


def write_views(path: Path, views: NDArray, bits: int | None = None) -> None:
    """Write a light field as a folder of PNG images `NAME_RR_CC.png`, named after the folder.

    Args:
        path: The folder.
        views: Floating point, clipped to [0, 1]; 2 or 4 channels: the last is a weight, [V, U, C, H, W].
        bits: 8 (default) or 16.

    Raises:
        InputError: NaN or infinity, or another depth or channel count.
        FileError: The disk refuses, or the folder holds anything but such a light field of ours.
    """
    # A leading dot would hide the files from the reader.
    stem = path.absolute().name.lstrip(".") or "view"
    encode.sample_type(path / "x.png", bits)
    named = ((f"{stem}_{row:02d}_{column:02d}.png", views[row, column]) for row, column in np.ndindex(views.shape[:2]))
    write_images(path, named, "views", bits)


def write_images(
    path: Path, named: Iterable[tuple[str, NDArray]], kind: str, bits: int | None, quality: int = encode.QUALITY
) -> None:
    """Write PNG or JPEG images as a folder, which takes the place of an older one of its kind.

    Args:
        path: The folder.
        named: Name and image, floating point, [C, H, W], of each file.
        kind: As `marks.check_folder`.
        bits: 8 (default) or 16, which PNG has.
        quality: Of JPEG images, from 1 to 100.

    Raises:
        InputError: NaN or infinity, or another depth or channel count.
        FileError: The disk refuses, or the folder holds anything but such a folder of ours.
    """
    marks.check_folder(path, kind)
    with atomic.replacing_folder(path) as partial:
        for name, image in named:
            images.write_image(partial / name, image.transpose(1, 2, 0), bits=bits, quality=quality)
        marks.mark_folder(partial, kind)
