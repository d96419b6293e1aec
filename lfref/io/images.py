"""Single image files as numpy arrays [H, W, C]: row y, column x, channel."""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from lfref.encoding import Encoding
from lfref.errors import InputError
from lfref.io import decode, encode


def read_image(path: str | Path) -> NDArray:
    """The first image of a file in one of `decode.PICTURES`.

    Args:
        path: The file.

    Returns:
        Samples in the file's own type (uint8, uint16; float32 for half and float), alpha not multiplied into
        the colours, [H, W, C] with C 1 to 4.

    Raises:
        FileError: The file is missing, damaged, too large, of another format, or holds NaN or infinity.
    """
    path = Path(path)
    with decode.opened(path) as source:
        return decode.decode(source, path)


def write_image(path: str | Path, array: NDArray, *, bits: int | None = None, quality: int = encode.QUALITY) -> None:
    """Write an image file, all of it or nothing.

    Args:
        path: The file to write, with a suffix of `encode.DEPTHS`; folders above it are made.
        array: [H, W, C] with C 1 to 4 (2 and 4: the last is a weight, which JPEG and AVIF have not); floats in [0, 1],
            which whole numbers clip and round and floating point keeps as they are; or uint8 or uint16.
        bits: 8, 16 or 32, as `encode.DEPTHS` has them (default: the first, but 16 for a uint16 array as PNG or TIFF).
        quality: Of a JPEG or AVIF, from 1 to 100.

    Raises:
        InputError: NaN or infinity, or a suffix, depth, shape or type that the format does not have.
        FileError: The folder or the disk refuses.
    """
    path = Path(path)
    if bits is None and array.dtype == np.uint16 and path.suffix.lower() in (".png", ".tif"):
        bits = 16
    encode.encode(path, [encode.Part(to_float(array))], bits, quality)


def to_float(array: NDArray) -> NDArray[np.float32]:
    """Samples as contiguous float32, integers scaled to [0, 1].

    Args:
        array: uint8, uint16 or floating point, any shape. Floats keep their values, also beyond [0, 1].

    Returns:
        Samples, float32, C-contiguous, the same shape.

    Raises:
        InputError: Another type.
    """
    if array.dtype.kind != "f" and array.dtype not in (np.uint8, np.uint16):
        raise InputError("images must be uint8, uint16 or floating point", got=array.dtype, remedy="convert them")
    samples = np.ascontiguousarray(array, dtype=np.float32)
    if array.dtype.kind == "u":
        samples /= np.iinfo(array.dtype).max
    return samples


def decoded(array: NDArray, encoding: Encoding) -> NDArray[np.float32]:
    """Linear light of samples.

    Args:
        array: uint8, uint16 or floating point, any shape.
        encoding: How they stand for light.

    Returns:
        Light, float32, C-contiguous, the same shape.

    Raises:
        InputError: Another type.
    """
    if array.dtype not in (np.uint8, np.uint16) or encoding.curve == "linear":
        return encoding.decode(torch.from_numpy(to_float(array))).numpy()
    # A light field has millions of samples, but few values.
    values = np.arange(np.iinfo(array.dtype).max + 1, dtype=array.dtype)
    table = encoding.decode(torch.from_numpy(to_float(values)).double()).float().numpy()
    return table.take(np.ascontiguousarray(array))


def encoded(array: NDArray, encoding: Encoding) -> NDArray[np.float32]:
    """Samples that stand for linear light.

    Args:
        array: Light, floating point, any shape.
        encoding: How they shall stand for it.
    """
    return encoding.encode(torch.from_numpy(to_float(array))).numpy()
