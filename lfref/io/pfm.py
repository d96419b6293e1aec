"""Portable float maps (PFM): one picture of 32-bit floats, the usual form of disparity maps in data sets.

A text header (`Pf` grey or `PF` colour, width and height, a scale whose sign tells the byte order), then the rows from
the bottom up. Source: Debevec's description of the format.
"""

import re
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import FileError, InputError
from lfref.io import atomic, images

HEADER = re.compile(rb"P([Ff])\s+(\d+)\s+(\d+)\s+(-?[\d.]+(?:[eE][-+]?\d+)?)\s", re.ASCII)
"""The last white space is one byte: what follows is data."""
LETTERS = {1: b"f", 3: b"F"}
SCALE = b"-1.0000000000"
"""Little-endian. Nobody else writes so many zeros, so a file with them is ours and may be replaced."""


def read(path: str | Path) -> NDArray[np.float32]:
    """Values of a PFM file as stored, top row first, float32, [H, W, C] with C 1 or 3.

    NaN and infinity too, which some data sets write where nothing is known. The size of the scale changes nothing: data
    sets disagree on it.

    Example:
        >>> from lfref.io import pfm
        >>> pfm.write("disparity.pfm", np.zeros((24, 32), np.float32))
        >>> pfm.read("disparity.pfm").shape
        (24, 32, 1)
    """
    path = Path(path)
    with atomic.file_errors(path, "read"):
        contents = path.read_bytes()
    header = HEADER.match(contents)
    if header is None:
        raise FileError(f"{path} must be a PFM file", got="no such header", remedy="copy or convert it again")
    width, height, n_channels = int(header[2]), int(header[3]), 1 if header[1] == b"f" else 3
    data = memoryview(contents)[header.end() :]
    expected = 4 * width * height * n_channels
    if expected == 0 or len(data) != expected:
        got = f"{len(data)} bytes for {width}x{height} pixels of {4 * n_channels}"
        raise FileError(f"{path} must hold as many pixels as it says", got=got, remedy="copy it again")
    order = "<" if header[4].startswith(b"-") else ">"
    rows = np.frombuffer(data, f"{order}f4").reshape(height, width, n_channels)
    return np.ascontiguousarray(rows[::-1], dtype=np.float32)


def read_hci_disparity(path: str | Path) -> Tensor:
    """Slopes [H, W] at which pixels are sharp, from a disparity map of HCI's benchmark, as `gt_disp_lowres.pfm`.

    Near things have positive disparity there, and a negative slope here: they move to the left where the camera moves
    to the right. Source: Honauer et al., "A Dataset and Evaluation Methodology for Depth Estimation on 4D Light
    Fields", 2016.

    Example:
        >>> from lfref.io import pfm
        >>> pfm.write("gt_disp_lowres.pfm", np.full((24, 32), 1.5, np.float32))
        >>> pfm.read_hci_disparity("gt_disp_lowres.pfm").unique()
        tensor([-1.5000])
    """
    values = read(path)
    if values.shape[2] != 1:
        raise FileError(f"{path} must be a grey PFM file", got="colours", remedy="give gt_disp_lowres.pfm")
    return -torch.from_numpy(values[..., 0])


def write(path: str | Path, values: NDArray) -> None:
    """Write a PFM file, all of it or nothing: finite values, top row first, [H, W] or [H, W, C] with C 1 or 3."""
    path = Path(path)
    picture = values[..., None] if values.ndim == 2 else values
    if picture.ndim != 3 or picture.shape[2] not in LETTERS or 0 in picture.shape:
        raise InputError(f"a picture for {path} must be [H, W] or [H, W, 1 or 3]", got=f"shape {values.shape}")
    samples = images.quantised(picture, "float", path)
    if path.is_file():
        with atomic.file_errors(path, "read"), path.open("rb") as file:
            header = HEADER.match(file.read(64))
        if header is None or header[4] != SCALE:
            expected = f"{path} must be a PFM file that lfref wrote to be replaced"
            raise FileError(expected, got="another file", remedy="choose another name, or move that one away")
    height, width, n_channels = samples.shape
    with atomic.replacing(path) as partial:
        first_lines = b"P%s\n%d %d\n%s\n" % (LETTERS[n_channels], width, height, SCALE)
        partial.write_bytes(first_lines + samples[::-1].astype("<f4").tobytes())
