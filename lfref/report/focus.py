"""The picture of a focus index: where each pixel is sharpest, in colour, and how sure that is, as opacity."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError
from lfref.report import drawing

WIDTH = 7.0  # inches
SURE = 0.1  # confidence from which a slope has a say in the scale of colours
OPAQUE, LEAST_OPAQUE = 0.9, 0.25  # share of pixels that may be paler than others; confidence that always may
OUTLIERS = 0.02  # of that say, at either end of the scale


def focus_map(slopes: Tensor, confidence: Tensor) -> Figure:
    """A map of slopes with its colour bar, which spans what is sure; what nobody can tell fades to white.

    Args:
        slopes: Slope at which each pixel is sharpest, in pixels per view step, [H, W].
        confidence: How clearly it is, [0, 1], [H, W].

    Raises:
        InputError: They are no maps of one size.
    """
    if slopes.ndim != 2 or slopes.shape != confidence.shape:
        raise InputError(
            "slopes and confidence must be [H, W]", got=f"{list(slopes.shape)} and {list(confidence.shape)}"
        )
    height, width = slopes.shape
    figure = drawing.new_figure(WIDTH, 0.4 + (WIDTH - 1) * height / width)
    axes = figure.subplots()
    values, opacity = slopes.double().cpu().numpy(), _opacity(confidence.double().cpu().numpy())
    low, high = _scale(values, opacity)
    # Drawn twice, the first time invisibly: a colour bar of a half transparent picture would be pale too.
    shown = axes.imshow(values, cmap=drawing.MAP, vmin=low, vmax=high, alpha=0 * opacity)
    bar = figure.colorbar(shown, ax=axes, label="slope, px per view step", pad=0.02)
    if bar.solids is not None:
        bar.solids.set_alpha(1)
    axes.imshow(values, cmap=drawing.MAP, vmin=low, vmax=high, alpha=opacity)
    axes.set_axis_off()
    return figure


def _opacity(confidence: NDArray) -> NDArray:
    """Confidence beside that of most others: of planes close together none is much sharper than the next."""
    return (confidence / max(LEAST_OPAQUE, np.quantile(confidence, OPAQUE))).clip(0, 1)


def _scale(values: NDArray, confidence: NDArray) -> tuple[float, float]:
    """From the least to the largest value, but for outliers; each counts as much as it is sure."""
    has_say = (confidence > SURE) | (confidence == confidence.max())
    order = values[has_say].argsort()
    ordered, say = values[has_say][order], confidence[has_say][order].cumsum()
    low, high = np.searchsorted(say, [OUTLIERS * say[-1], (1 - OUTLIERS) * say[-1]])
    return float(ordered[low]), float(ordered[min(high, len(ordered) - 1)])
