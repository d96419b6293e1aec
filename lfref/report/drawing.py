"""What all plots share: the palette, figures without a display, calm axes, PNG files.

PSNR is capped at 100 dB; where a plot has capped and other values, the empty stretch between them is folded together.
Colours are ones that colour-blind readers tell apart (Tol, "Colour schemes", SRON 2021, scheme "vibrant").
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from lfref.io import atomic, images
from lfref.report.tables import CAP_DB

BLUE, RED, TEAL, ORANGE, MAGENTA, CYAN = "#0077BB", "#CC3311", "#009988", "#EE7733", "#EE3377", "#33BBEE"
BLACK, GREY, PALE = "#222222", "#767676", "#DDDDDD"
COLOURS = (BLUE, RED, TEAL, ORANGE, BLACK, CYAN, MAGENTA, GREY)
MARKERS = ("o", "^", "s", "D", "v", "P", "X", "<", ">", "p", "h", "*")
MAP = "viridis"
"""Colours of a map of slopes or disparities."""
PNG: dict[str, Any] = {
    "format": "png",
    "dpi": 150,
    "bbox_inches": "tight",
    "pad_inches": 0.12,
    "pil_kwargs": {"compress_level": images.PNG_LEVEL},
}


def new_figure(width: float, height: float) -> Figure:
    """An empty white figure on the Agg canvas, sizes in inches."""
    figure = Figure(figsize=(width, height), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def new_sheet(pixels: np.ndarray) -> Figure:
    """A figure whose file is an image, pixel for pixel, and what is written on it; [H, W, 3] of uint8."""
    height, width = pixels.shape[:2]
    figure = Figure(figsize=(width / PNG["dpi"], height / PNG["dpi"]), dpi=PNG["dpi"], facecolor="white")
    FigureCanvasAgg(figure)
    figure.figimage(pixels)
    return figure


def save_options(figure: Figure) -> dict[str, Any]:
    """How a figure is saved: cut to what is drawn, but a sheet as it is."""
    return PNG if figure.get_layout_engine() else {**PNG, "bbox_inches": None}


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write the figure as a PNG file, all or nothing."""
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, **save_options(figure))


def look(index: int, colours: Sequence[str] = COLOURS) -> dict[str, Any]:
    """Colour and marker of a series by its place among all of them."""
    return {"color": colours[index % len(colours)], "marker": MARKERS[index % len(MARKERS)]}


def calm(axes: Axes, x: str, y: str, title: str, pad: float = 6) -> None:
    """Title, axis names, a pale grid, and no frame on the top and right."""
    axes.set_title(title, fontsize=10.5, loc="left", color=BLACK, pad=pad)
    axes.set(xlabel=x, ylabel=y)
    axes.tick_params(labelsize=9, color=GREY)
    axes.grid(color=PALE, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)


def fold_below_cap(axes: Axes) -> None:
    """Where some PSNRs are capped and the others lie far below, shrink the empty stretch between them."""
    values = np.concatenate([line.get_ydata() for line in axes.get_lines() if line.get_marker() not in ("", "None")])
    below = values[values < CAP_DB]
    if 0 < below.size < values.size and CAP_DB - below.max() > np.ptp(below) + 10:
        _fold(axes, below.min(), below.max())


def _fold(axes: Axes, low: float, high: float) -> None:
    pad = max(0.08 * (high - low), 1.0)
    knee, floor = high + pad, low - pad
    squeeze = 0.15 * (knee - floor) / (CAP_DB - knee)

    def folded(factor: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda y: np.where(y > knee, knee + (y - knee) * factor, y)

    axes.set_yscale("function", functions=(folded(squeeze), folded(1 / squeeze)))
    ticks = [tick for tick in MaxNLocator(6).tick_values(floor, knee) if floor <= tick <= knee]
    axes.set_yticks([*ticks, CAP_DB], [*(f"{tick:g}" for tick in ticks), f"≥ {CAP_DB:g}"])
    axes.set_ylim(floor, CAP_DB + pad / squeeze)
    # Of values that lie close together the stretch is lower than the pad.
    axes.axhspan(knee, CAP_DB - min(pad / squeeze, (CAP_DB - knee) / 3), color=PALE, alpha=0.35, linewidth=0, zorder=0)
