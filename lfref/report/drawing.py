"""Parts that all plots share: the palette, figures without a display, the style of axes, PNG files.

PSNR is capped at 100 dB; where a plot has capped and other values, the empty stretch between them is shrunk.
Colour-blind readers can distinguish the colours (Tol, "Colour schemes", SRON 2021, scheme "vibrant").
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import MaxNLocator

from lfref.io import atomic, images
from lfref.report.tables import CAP_DB

BLUE, RED, TEAL, ORANGE, MAGENTA, CYAN = "#0077BB", "#CC3311", "#009988", "#EE7733", "#EE3377", "#33BBEE"
BLACK, GREY, PALE = "#222222", "#767676", "#DDDDDD"
COLOURS = (BLUE, RED, TEAL, ORANGE, BLACK, CYAN, MAGENTA, GREY)
MARKERS = ("o", "^", "s", "D", "v", "P", "X", "<", ">", "p", "h", "*")
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


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write the figure as a PNG file, all or nothing."""
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, **PNG)


def series_style(index: int, colours: Sequence[str] = COLOURS) -> dict[str, Any]:
    """Colour and marker of series number `index`."""
    return {"color": colours[index % len(colours)], "marker": MARKERS[index % len(MARKERS)]}


def style_axes(axes: Axes, x: str, y: str, title: str, pad: float = 6) -> None:
    """Set title and labels; draw a pale grid, and no frame at the top and right."""
    axes.set_title(title, fontsize=10.5, loc="left", color=BLACK, pad=pad)
    axes.set(xlabel=x, ylabel=y)
    axes.tick_params(labelsize=9, color=GREY)
    axes.grid(color=PALE, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)


Curve = tuple[Sequence[float] | np.ndarray, Sequence[float] | np.ndarray, dict[str, Any]]
"""Abscissas and ordinates of a line, and its style."""
MOST_LINES = 7
"""Number of lines that a reader can follow in one panel."""
COLUMNS = 4
"""Small panels in a row."""


def draw_curves(figure: FigureBase, curves: Mapping[str, Curve], x: str, y: str, title: str) -> list[Axes]:
    """Draw lines in one panel; more than `MOST_LINES` get a panel each, in which all others are grey.

    Args:
        figure: Figure, or a part of one, without panels.
        curves: Name of each line -> the line.
        x: Label of the abscissa.
        y: Label of the ordinate.
        title: Title of all lines.

    Returns:
        The panels; only a single one has lines with labels, for a legend.
    """
    if len(curves) <= MOST_LINES:
        axes = figure.add_subplot()
        for name, (xs, ys, style) in curves.items():
            axes.plot(xs, ys, **style | {"label": name})
        style_axes(axes, x, y, title)
        return [axes]
    grid = figure.subplots(math.ceil(len(curves) / COLUMNS), COLUMNS, squeeze=False, sharex=True, sharey=True)
    figure.suptitle(title, fontsize=10.5, x=0.01, ha="left", color=BLACK)
    for axes in grid.flat[len(curves) :]:
        axes.set_visible(False)
    panels = list(grid.flat[: len(curves)])
    for axes, (name, (own_x, own_y, style)) in zip(panels, curves.items(), strict=True):
        for xs, ys, _ in curves.values():
            axes.plot(xs, ys, color=PALE, linewidth=0.8, zorder=1)
        axes.plot(own_x, own_y, zorder=3, **style | {"color": BLUE, "marker": "o", "markersize": 3, "label": "_"})
        style_axes(axes, "", "", "")
        axes.set_title(name, fontsize=8, loc="left", color=BLACK, pad=3)
    for axes in panels[-COLUMNS:]:
        axes.xaxis.set_tick_params(labelbottom=True)
        axes.set_xlabel(x, fontsize=9)
    for axes in grid[:, 0]:
        axes.set_ylabel(y, fontsize=9)
    return panels


def curves_height(n_lines: int) -> float:
    """Height in inches of the panels of so many lines."""
    return 3.8 if n_lines <= MOST_LINES else 0.7 + 1.45 * math.ceil(n_lines / COLUMNS)


def fold_below_cap(axes: Axes) -> None:
    """Shrink the empty stretch between capped PSNRs and all others, if these lie far below."""
    values = np.concatenate([line.get_ydata() for line in axes.get_lines() if line.get_marker() not in ("", "None")])
    below = values[values < CAP_DB]
    if not 0 < below.size < values.size or CAP_DB - below.max() <= np.ptp(below) + 10:
        return
    pad = max(0.08 * np.ptp(below), 1.0)
    knee, floor = below.max() + pad, below.min() - pad
    squeeze = 0.15 * (knee - floor) / (CAP_DB - knee)  # the stretch takes 15 % of the height below it

    def folded(factor: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda y: np.where(y > knee, knee + (y - knee) * factor, y)

    axes.set_yscale("function", functions=(folded(squeeze), folded(1 / squeeze)))
    ticks = [tick for tick in MaxNLocator(6).tick_values(floor, knee) if floor <= tick <= knee]
    axes.set_yticks([*ticks, CAP_DB], [*(f"{tick:g}" for tick in ticks), f"≥ {CAP_DB:g}"])
    axes.set_ylim(floor, CAP_DB + pad / squeeze)
    # Where values lie close together the stretch is lower than the pad.
    axes.axhspan(knee, CAP_DB - min(pad / squeeze, (CAP_DB - knee) / 3), color=PALE, alpha=0.35, linewidth=0, zorder=0)
