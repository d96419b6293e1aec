"""Layout of the pictures of the pages: titled cells side by side, maps with a colour bar, small letters.

All are 900 pixels wide. Photographs are written as JPEG, which takes a third of PNG's space for them.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from PIL import Image
from torch import Tensor

from lfref.functional.psnr import psnr
from lfref.io import atomic
from lfref.report import drawing, pictures, tables

WIDTH = 6.0  # inches
BAR_WIDTH = 0.75
TITLE: dict[str, Any] = {"fontsize": 8, "color": drawing.BLACK, "pad": 3}
ERROR: dict[str, Any] = {"cmap": "magma", "norm": LogNorm(1e-6, 1)}
SHARE: dict[str, Any] = {"cmap": "cividis", "vmin": 0, "vmax": 1}
JPEG = {"format": "jpg", "pil_kwargs": {"quality": 83, "subsampling": 0, "optimize": True}}


def sheet(cells: Iterable[tuple[str, Tensor]], n_columns: int = 3, bar: str = "", **style: Any) -> Figure:
    """Cells in reading order, all of one shape.

    Args:
        cells: Title and what is shown: pictures, [C, H, W], or maps, [H, W].
        n_columns: Cells in a row.
        bar: What the colour bar of the maps says; needed if there are maps.
        style: How `imshow` shows the maps.
    """
    cells = list(cells)
    n_rows, n_lines = -(-len(cells) // n_columns), cells[0][0].count("\n") + 1
    (height, width), room = cells[0][1].shape[-2:], WIDTH - (BAR_WIDTH if bar else 0)
    figure = drawing.new_figure(WIDTH, n_rows * (room / n_columns * height / width + 0.18 * n_lines))
    figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0, hspace=0)
    grid = figure.subplots(n_rows, n_columns, squeeze=False)
    shown = [(show(axes, *cell, **style), cell[1].ndim) for axes, cell in zip(grid.flat, cells, strict=True)]
    maps = [image for image, ndim in shown if ndim == 2]
    if maps:
        legend = figure.colorbar(maps[0], ax=[image.axes for image in maps], pad=0.01, aspect=15)
        legend.set_label(bar, fontsize=8)
        legend.ax.tick_params(labelsize=7)
    return figure


def show(axes: Axes, title: str, values: Tensor, **style: Any) -> AxesImage:
    """A picture, [C, H, W], as it is, or a map, [H, W], in a style."""
    axes.set_axis_off()
    axes.set_title(title, **TITLE)
    return axes.imshow(values, **style) if values.ndim == 2 else axes.imshow(pictures.for_display(values))


def error(title: str, image: Tensor, truth: Tensor) -> tuple[str, Tensor]:
    """A cell with the error of an image in the style `ERROR`, its PSNR at the end of the title."""
    size = (image - truth).abs().mean(0).clamp(min=ERROR["norm"].vmin)  # zero has no logarithm
    return f"{title}{decibels(image, truth)}", size


def decibels(image: Tensor, truth: Tensor) -> str:
    """PSNR as it is written."""
    value = float(psnr(image, truth))
    return f"{value:.0f} dB" if value < tables.CAP_DB else f"≥ {tables.CAP_DB:.0f} dB"


def at(slope: float) -> str:
    """A slope as it is written."""
    return f"s = {slope:+.3g}".replace("-", tables.MINUS) if slope else "s = 0"


def label(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Names of the axes, in letters as small as those of the cells."""
    drawing.style_axes(axes, x, y, "")
    axes.set_title(title, **TITLE)
    axes.tick_params(labelsize=7)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set_size(8)


def save(figure: Figure, path: Path) -> None:
    """Write a figure, all or nothing, as its suffix says: `.jpg` or `.png`."""
    with atomic.replacing(path) as temporary:
        options = drawing.PNG | (JPEG if path.suffix == ".jpg" else {})
        # A picture in its own pixels has no axes, and is not cut.
        figure.savefig(temporary, **(options if figure.axes else options | {"bbox_inches": None}))
        if path.suffix == ".png" and not any(axes.images for axes in figure.axes):
            # Lines and letters have few colours: a palette takes a third of the bytes.
            with Image.open(temporary) as drawn:
                drawn.convert("RGB").quantize().save(temporary, optimize=True)
