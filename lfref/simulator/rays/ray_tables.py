"""The tables that compiled loops take of layers whose rays are followed.

Letters: as in `ray_loop`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.simulator.canvases import OVERSAMPLING, Box
from lfref.simulator.painting.layers import Highlight, Layer
from lfref.simulator.rays.ray_loop import Atlas, Sights

NO_LOBE = Highlight(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Page(NamedTuple):
    """Samples, and where they lie on a surface."""

    samples: NDArray[np.floating]
    """Premultiplied RGBA in the order in which loops want it, [h, w, 4] or [4, h, w]."""
    opacity: NDArray[np.floating]
    """The part of it that is opacity, [h, w]."""
    top: int
    """Y of the first row in samples."""
    left: int
    """X of the first column in samples."""


def atlas(pictures: Sequence[Page]) -> Atlas:
    """Put pictures one after the other."""
    arrays = [picture.samples.reshape(-1) for picture in pictures]
    starts = np.cumsum([0, *(array.size for array in arrays)])[:-1]
    frames = [
        (start, *picture.opacity.shape, picture.top, picture.left)
        for start, picture in zip(starts, pictures, strict=True)
    ]
    samples = np.concatenate(arrays) if arrays else np.zeros(0, np.float32)
    return Atlas(samples, np.array(frames, np.int64).reshape(-1, 5))


def sights(
    layers: Sequence[Layer],
    spans: Sequence[tuple[float, float]],
    boxes: Sequence[Box],
    pictures: Sequence[tuple[int, int]],
) -> Sights:
    """Describe layers.

    Args:
        layers: From far to near.
        spans: Least and greatest disparity that any ray meets of each.
        boxes: Where each may be seen.
        pictures: Place in an atlas of each one's picture, and of the picture that it mirrors or -1.
    """
    mirrors = [layer.reflection[1:] if layer.reflection else (0.0, 0.0) for layer in layers]
    return Sights(
        _table([layer.surface.geometry.form for layer in layers], 7),
        _table(spans, 2),
        _table(boxes, 4),
        np.array(pictures, np.int64).reshape(-1, 2),
        _table(mirrors, 2),
        _table([layer.highlight or NO_LOBE for layer in layers], 7),
        np.array([layer.surface.geometry.is_parallel for layer in layers], np.bool_),
        np.array([layer.hides for layer in layers], np.bool_),
    )


def _table(rows: Sequence[tuple[float, ...]], n_columns: int) -> NDArray[np.float64]:
    return np.array(rows, np.float64).reshape(-1, n_columns)


def box(picture: Page, margin: float) -> Box:
    """Where a picture may be seen that goes on beyond its ends.

    Args:
        picture: Whose opacity counts.
        margin: Pixels that are looked at around a point.
    """
    is_seen, left, top = picture.opacity != 0, math.inf, math.inf
    right, bottom = -math.inf, -math.inf
    if is_seen.any():
        top, bottom = _seen(is_seen.any(axis=1), picture.top, margin)
        left, right = _seen(is_seen.any(axis=0), picture.left, margin)
    return left, top, right, bottom


def _seen(is_seen: NDArray[np.bool_], start: int, margin: float) -> tuple[float, float]:
    """First and last place that is seen, in pixels, without end where the outermost ones are."""
    places = np.flatnonzero(is_seen)
    first, last = int(places[0]), int(places[-1])
    low = -math.inf if first == 0 else (first + start) / OVERSAMPLING - margin
    high = math.inf if last == len(is_seen) - 1 else (last + start) / OVERSAMPLING + margin
    return low, high
