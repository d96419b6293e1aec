"""Portable float maps (PFM): one picture of 32-bit floats, as disparity is passed on.

A text header (`Pf` grey or `PF` colour, width and height, a scale whose sign says the order of bytes), then the rows
from the bottom up. Source: Debevec's description of the format.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io import atomic, encode

HEADER = re.compile(rb"P([Ff])\s+(\d+)\s+(\d+)\s+(-?[\d.]+(?:[eE][-+]?\d+)?)\s", re.ASCII)
"""The last white space is one byte: what follows is data."""
CHANNELS = {b"f": 1, b"F": 3}
SCALE = b"-1.0000000000"
"""Little-endian. Nobody else writes so many zeros, so a file with them is ours and may be replaced."""


def read(path: str | Path) -> NDArray[np.float32]:
    """Read a PFM file.

    Args:
        path: The file.

    Returns:
        Values as they are stored, NaN and infinity too (which some data sets write where nothing is known), top row
        first, float32, [H, W, C] with C 1 or 3. How large the scale is changes nothing: data sets disagree on it.

    Raises:
        FileError: The file is missing, no PFM, or shorter or longer than its header says.

    Example:
        >>> from lfref.io import pfm
        >>> pfm.write("disparity.pfm", np.zeros((24, 32), np.float32))
        >>> pfm.read("disparity.pfm").shape
        (24, 32, 1)
    """
    path = Path(path)
    with atomic.explained(path, "read"):
        contents = path.read_bytes()
    header = HEADER.match(contents)
    if header is None:
        raise FileError(f"{path} must be a PFM file", got="no such header", remedy="copy or convert it again")
    width, height, n_channels = int(header[2]), int(header[3]), CHANNELS[header[1]]
    data = memoryview(contents)[header.end() :]
    expected = 4 * width * height * n_channels
    if expected == 0 or len(data) != expected:
        got = f"{len(data)} bytes for {width}x{height} pixels of {4 * n_channels}"
        raise FileError(f"{path} must hold as many pixels as it says", got=got, remedy="copy it again")
    order = "<" if header[4].startswith(b"-") else ">"
    rows = np.frombuffer(data, f"{order}f4").reshape(height, width, n_channels)
    return np.ascontiguousarray(rows[::-1], dtype=np.float32)


def write(path: str | Path, values: NDArray) -> None:
    """Write a PFM file, all of it or nothing.

    Args:
        path: The file; folders above it are made.
        values: Finite, top row first, [H, W] or [H, W, C] with C 1 or 3.

    Raises:
        InputError: Another shape, NaN or infinity.
        FileError: The folder or the disk refuses, or a file of that name is not ours.
    """
    path = Path(path)
    picture = values[..., None] if values.ndim == 2 else values
    if picture.ndim != 3 or picture.shape[2] not in CHANNELS.values() or 0 in picture.shape:
        raise InputError(f"a picture for {path} must be [H, W] or [H, W, 1 or 3]", got=f"shape {values.shape}")
    samples = encode.quantised(picture, "float", path)
    _check_ours(path)
    height, width, n_channels = samples.shape
    letter = {1: b"Pf", 3: b"PF"}[n_channels]
    with atomic.replacing(path) as partial:
        header = b"%s\n%d %d\n%s\n" % (letter, width, height, SCALE)
        partial.write_bytes(header + samples[::-1].astype("<f4").tobytes())


def _check_ours(path: Path) -> None:
    """Refuse to replace a file that we did not write."""
    if not path.is_file():
        return
    with atomic.explained(path, "read"), path.open("rb") as file:
        header = HEADER.match(file.read(64))
    if header is None or header[4] != SCALE:
        expected = f"{path} must be a PFM file that lfref wrote to be replaced"
        raise FileError(expected, got="another file", remedy="choose another name, or move that one away")
