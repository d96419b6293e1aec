"""Colours of a map of disparity, the same on the refocus page and in files.

This module stands apart from both: neither may show another map than the other.
"""

from collections.abc import Sequence

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from lfref.encoding import SRGB
from lfref.io import images

MAP = "viridis"
"""Colour map of slopes and disparities."""
LEAST_CONFIDENCE, GREY = 0.1, 0.5
"""Least confidence of a known disparity; below, the colours of the map fade to this grey."""


def ends(slopes: NDArray[np.floating], planes: Sequence[float]) -> tuple[float, float]:
    """Range of the map's colours: the overlap of planes and slopes, or all slopes if there is no overlap."""
    least, largest = float(slopes.min()), float(slopes.max())
    low, high = max(min(planes), least), min(max(planes), largest)
    return (low, high) if low < high else (least, largest)


def coloured(slopes: NDArray[np.floating], low: float, high: float) -> NDArray[np.float64]:
    """Slopes in the colours of the map."""
    positions = ((slopes - low) / max(high - low, 1e-9)).clip(0, 1).astype(np.float32)
    mapped = OpenImageIO.ImageBufAlgo.color_map(OpenImageIO.ImageBuf(positions[..., None]), 0, MAP)
    # OpenImageIO's colours are linear light.
    return images.encoded(np.asarray(mapped.get_pixels("float")), SRGB).astype(np.float64)


def greyed(colours: NDArray[np.float64], confidence: NDArray[np.floating]) -> NDArray[np.float64]:
    """Colours of the map, faded to grey where the disparity is unknown."""
    share = (confidence / LEAST_CONFIDENCE).clip(0, 1)[..., None]
    greyed: NDArray[np.float64] = share * colours + (1 - share) * GREY
    return greyed
