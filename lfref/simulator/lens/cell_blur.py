"""Pictures that face the camera, blurred by the way that they move within a cell of the aperture.

Letters: `e` relative slope in pixels per view step, `o` samples a pixel, `J I` rows and columns of cells.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.lens.aperture_cells import Cells


class Filter(NamedTuple):
    """How a picture is blurred within a cell, and where it is then read through every cell."""

    down: NDArray[np.float64]
    """Taps along a column."""
    across: NDArray[np.float64]
    """Taps along a row."""
    rows: NDArray[np.float64]
    """What pixel 0 reads through each row of cells, in samples of a plane's window, [J]."""
    columns: NDArray[np.float64]
    """Likewise through each column of cells, [I]."""


def cell_filter(e: float, cells: Cells, margin: int) -> Filter:
    """The filter of a picture.

    Args:
        e: Its relative slope.
        cells: Of the aperture.
        margin: Pixels that the window goes beyond the central view.
    """
    rows, columns = (OVERSAMPLING * (margin + e * centres.numpy()) for centres in (cells.q, cells.p))
    way = OVERSAMPLING * abs(e)
    return Filter(box_taps(way * cells.height, rows), box_taps(way * cells.width, columns), rows, columns)


def box_taps(width: float, positions: NDArray) -> NDArray:
    """A filter that, together with linear look-ups at some positions, has the variance of a box.

    Args:
        width: Of the box in samples.
        positions: Of the look-ups in samples.

    Returns:
        Taps of sum 1, symmetric, odd in number.
    """
    half = max(width, 1) / 2
    n = np.arange(-math.ceil(half - 0.5), math.ceil(half - 0.5) + 1)
    box = np.minimum(n + 0.5, half) - np.maximum(n - 0.5, -half)
    box /= box.sum()
    share = positions % 1
    excess = (box * n**2).sum() + (share * (1 - share)).mean() - width**2 / 12
    return np.convolve(box, [-excess / 2, 1 + excess, -excess / 2])


def linear_variance(e: NDArray, cells: Cells) -> NDArray:
    """What linear look-ups through all cells blur on average, the mean of both axes.

    Args:
        e: Relative slopes, [T].
        cells: Of the aperture.

    Returns:
        Variances in samples squared, [T].
    """
    shares = [(OVERSAMPLING * e[:, None] * centres.numpy()) % 1 for centres in (cells.q, cells.p)]
    return sum((share * (1 - share)).mean(1) for share in shares) / 2


def summed(taps: NDArray, positions: NDArray, weights: NDArray) -> tuple[int, NDArray]:
    """Filter and linear look-ups at several positions as one filter.

    Args:
        taps: Of the filter, odd in number.
        positions: Of the look-ups in samples.
        weights: Of each.

    Returns:
        Sample that the first tap reads, and the taps.
    """
    whole = np.floor(positions).astype(int)
    first, share = whole.min(), positions - whole
    spread = np.zeros(whole.max() - first + 2)
    np.add.at(spread, whole - first, weights * (1 - share))
    np.add.at(spread, whole - first + 1, weights * share)
    return int(first) - len(taps) // 2, np.convolve(spread, taps)
