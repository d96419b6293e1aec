"""Writing folders of images, all of it or nothing, in the place of nothing but an older one of ours.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.io import atomic, encode, images, marks

AT_ONCE = 4
"""Images that are compressed at the same time, and held in memory."""


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
        _write_all(((partial / name, image.transpose(1, 2, 0)) for name, image in named), bits, quality)
        marks.mark_folder(partial, kind)


def _write_all(named: Iterable[tuple[Path, NDArray]], bits: int | None, quality: int) -> None:
    """Write images, a few at a time: compression is most of the work, and lets go of the interpreter's lock."""
    under_way = deque[Future[None]]()
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for path, image in named:
            if len(under_way) == AT_ONCE:
                under_way.popleft().result()
            under_way.append(pool.submit(images.write_image, path, image, bits=bits, quality=quality))
        for file in under_way:
            file.result()
