"""Parts that all plots share: the palette, figures without a display, the style of axes, PNG files.

Colour-blind readers can distinguish the colours (Tol, "Colour schemes", SRON 2021, scheme "vibrant").
"""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from lfref.io import atomic, images

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


def series_style(index: int) -> dict[str, Any]:
    """Colour and marker of series number `index`."""
    return {"color": COLOURS[index % len(COLOURS)], "marker": MARKERS[index % len(MARKERS)]}


def style_axes(axes: Axes, x: str, y: str, title: str) -> None:
    """Set title and labels; draw a pale grid, and no frame at the top and right."""
    axes.set_title(title, fontsize=10.5, loc="left", color=BLACK)
    axes.set(xlabel=x, ylabel=y)
    axes.tick_params(labelsize=9, color=GREY)
    axes.grid(color=PALE, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
