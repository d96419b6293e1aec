"""Contact sheets: pictures in which the views stand side by side, and quilts, such sheets of light-field displays.

A quilt (`NAME_qs8x6a0.75.png`: 8 columns, 6 rows, aspect .75) holds one row of views, counted from the bottom left.
Gaps between views, and a frame around them, are lines of one colour.
Letters: `V U` view rows and columns, `C` channels, `H W` pixel rows and columns.
Source: Looking Glass Factory, "Quilts", documentation of the display.
"""

import re
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional as F

from lfref.errors import FileError
from lfref.io import images
from lfref.io.samples import Cell, ReadOptions, Samples, split_weight

QUILT = re.compile(r"_qs(?P<columns>\d+)x(?P<rows>\d+)a[\d.]+$")
MOST = 17
"""Most rows and columns of a sheet that is recognised."""
THUMBNAIL = 24
"""Side of the small pictures by which views of a sheet are compared, in pixels."""
LEAST_SIDE = 32
"""Least side of a view, in pixels."""
REDUCED = 512
"""Pixels along a picture that is searched for what repeats."""
ALIKE, PEAK = 0.6, 0.2
"""Least mean correlation of neighbouring views, and by how much other numbers of views are worse."""
REPEATS, APART, ROUNDED = 0.3, 0.1, 0.3
"""Correlation of a picture with itself, shifted, from which it repeats and below which it does not; largest distance
of the number of periods from a whole number, in views: gaps and disparities change it."""
FLAT = 0.3
"""Largest mean deviation of the samples of a line of a gap, of that of most lines: JPEG leaves ringing."""


def grid_of(path: Path, options: ReadOptions) -> Cell | None:
    """Rows and columns of the sheet at `path`, by the options, else by the name of a quilt; None: it is no sheet."""
    quilt = QUILT.search(path.stem)
    if options.grid is not None or quilt is None:
        return options.grid
    return int(quilt["rows"]), int(quilt["columns"])


def decode_sheet(path: Path, options: ReadOptions) -> Samples:
    """The chosen views of a sheet."""
    image = images.read_image(path)
    grid = rows, columns = grid_of(path, options) or (1, 1)
    tops, height = _spans(image, 0, rows, path)
    lefts, width = _spans(image, 1, columns, path)
    views = np.stack([np.stack([image[y : y + height, x : x + width] for x in lefts]) for y in tops])
    if options.grid is None:
        views, grid = views[::-1].reshape(1, rows * columns, *views.shape[2:]), (1, rows * columns)
    chosen = views[options.window(grid, path)].transpose(0, 1, 4, 2, 3)
    colours, weight = split_weight(chosen, axis=2)
    return Samples(colours, weight, images.encoding_of(path, options.encoding, images.usual_encoding(image)))


def _spans(image: NDArray, axis: int, count: int, path: Path) -> tuple[list[int], int]:
    """Where the views begin along an axis of a sheet [H, W, C], and their common length."""
    length = image.shape[axis]
    lines = np.moveaxis(image, axis, 0).astype(np.float32)
    deviation = np.abs(lines - np.median(lines, axis=1, keepdims=True)).mean(axis=(1, 2))
    flat = deviation < FLAT * np.median(deviation)
    # Runs of lines that are no gap.
    edges = np.flatnonzero(np.diff(np.concatenate([[True], flat, [True]]).astype(int)))
    begins, ends = edges[::2], edges[1::2]
    sides = ends - begins
    if len(begins) == count and sides.min() >= LEAST_SIDE and np.ptp(sides) <= 2 and flat.any():
        return begins.tolist(), int(sides.min())
    if length % count or length < count:
        expected = f"{path} must hold {count} {'columns' if axis else 'rows'} of views of one size"
        remedy = "set reader.grid=[rows,columns], or cut the picture"
        shown = likely_grid(split_weight(image)[0].mean(2))
        raise FileError(expected, got=f"{length} pixels", remedy=remedy, proposals=[{"grid": shown}] if shown else [])
    return list(range(0, length, length // count)), length // count


def likely_grid(grey: NDArray) -> Cell | None:
    """Rows and columns of views in a picture [H, W] that looks like a sheet; None if it does not."""
    rows, columns = (_likely_count(grey if axis else grey.T) for axis in (0, 1))
    return (rows, columns) if rows * columns > 1 else None


def _likely_count(grey: NDArray) -> int:
    """Number of views along the rows of a picture [H, W], which are alike; 0 if it repeats too often, 1 if never."""
    # Lenslets repeat at their pitch, views of a sheet at no shorter distance than their own side.
    periods = _periods(grey)
    count = round(periods)
    if count > min(MOST, grey.shape[1] // LEAST_SIDE):
        return 0
    if count < 2 or abs(periods - count) > ROUNDED:
        return 1
    alike, *others = (_likeness(grey, n_views) for n_views in (count, count - 1, count + 1))
    return count if alike >= ALIKE and alike - max(others) >= PEAK else 1


def _periods(grey: NDArray) -> float:
    """How often a picture [H, W] repeats along its rows; 1 if it does not."""
    from scipy import ndimage  # slow to import

    width = min(REDUCED, grey.shape[1])
    rows = _reduced(grey, min(REDUCED, len(grey)), width)
    rows = rows - ndimage.uniform_filter1d(rows, width // 8, axis=1)
    power = (np.abs(np.fft.rfft(rows, 2 * width)) ** 2).sum(axis=0)
    alike = np.fft.irfft(power)[:width] / np.arange(width, 0, -1)
    alike = alike[: width * 3 // 4] / max(float(alike[0]), 1e-30)
    beyond = np.flatnonzero(alike < APART)
    if not len(beyond) or (highest := alike[beyond[0] :].max()) < REPEATS:
        return 1.0
    # The first of the highest peaks: all multiples of the period are about as high.
    first = beyond[0] + np.flatnonzero(alike[beyond[0] :] >= 0.75 * highest)[0]
    peak = first + int(alike[first : first + max(2, first // 8)].argmax())
    return width / peak


def _likeness(grey: NDArray, count: int) -> float:
    """Mean correlation of neighbouring ones of `count` parts along the rows of a picture [H, W]."""
    n_lines = min(4 * THUMBNAIL, grey.shape[0])
    parts = _reduced(grey, n_lines, THUMBNAIL * count).reshape(n_lines, count, THUMBNAIL)
    # Each line of a part without its mean, so that a row of the sheet does not decide by its level.
    parts = parts - parts.mean(axis=2, keepdims=True)
    first, second = parts[:, :-1], parts[:, 1:]
    norm = np.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / norm) if norm > 0 else 0.0


def _reduced(grey: NDArray, height: int, width: int) -> NDArray:
    """Means of rectangles of a picture of any type, float64, [height, width]."""
    return F.adaptive_avg_pool2d(torch.from_numpy(grey.astype(np.float64))[None], (height, width))[0].numpy()
