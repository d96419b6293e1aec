"""Plots of training and evaluation, each a matplotlib Figure that needs neither a display nor pyplot's state.

PSNR is capped at 100 dB.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lfref.report import tables, wording
from lfref.report.drawing import (
    BLACK,
    BLUE,
    CYAN,
    GREY,
    MAGENTA,
    ORANGE,
    RED,
    TEAL,
    calm,
    capped,
    fold_below_cap,
    new_figure,
)
from lfref.report.tables import Row

METHOD_COLOURS = (TEAL, ORANGE, BLACK, CYAN, MAGENTA, GREY)  # blue and red are for references
MARKERS = ("o", "^", "s", "D", "v", "P", "X", "<", ">", "p", "h", "*")
DASHES = ("-", "--", ":", "-.")
REFERENCE_COLOURS = {"shift_and_sum": BLUE, "fourier_slice": RED, "exact_fourier": TEAL}

LOSS_TERMS = {  # column of Lightning's metrics.csv: name, colour, line width
    "train/loss": ("total", BLACK, 1.8),
    "train/mse": ("MSE term", BLUE, 1.2),
    "train/l1": ("L1 term", TEAL, 1.2),
    "train/ssim": ("SSIM term", ORANGE, 1.2),
    "train/inverse_psnr": ("1/PSNR term", CYAN, 1.2),
    "val/loss": ("total, validation", RED, 1.8),
}


def training_curves(rows: Sequence[Row]) -> Figure:
    """The loss with its terms, and validation MPSNR and MSSIM with the rise above the first validation.

    Args:
        rows: Lightning's metrics.csv: `step`, `train/loss`, `val/mpsnr`, `val/mssim`; the terms where they are there.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    figure = new_figure(9, 4.8)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1))
    _draw_losses(figure.add_subplot(grid[:, 0]), rows)
    _draw_rise(figure.add_subplot(grid[0, 1]), rows)
    similarity = figure.add_subplot(grid[1, 1])
    _draw_steps(similarity, rows, "val/mssim", color=TEAL)
    calm(similarity, "Optimiser step", "MSSIM", "Validation MSSIM")
    return figure


def _draw_losses(axes: Axes, rows: Sequence[Row]) -> None:
    axes.set_yscale("log", nonpositive="mask")
    tables.some(rows, "train/loss")
    for column, (label, colour, width) in LOSS_TERMS.items():
        if column in tables.columns_of(rows):
            _draw_steps(axes, rows, column, color=colour, linewidth=width, label=label)
    axes.figure.legend(loc="outside lower left", ncols=len(LOSS_TERMS), frameon=False, fontsize=9)
    calm(axes, "Optimiser step", "Loss (log scale)", "Loss and its terms")


def _draw_rise(axes: Axes, rows: Sequence[Row]) -> None:
    kept = tables.some(rows, "step", "val/mpsnr")
    first, last = kept[0]["val/mpsnr"], kept[-1]["val/mpsnr"]
    step, best = max(((row["step"], row["val/mpsnr"]) for row in kept), key=lambda point: point[1])
    _draw_steps(axes, rows, "val/mpsnr", color=BLUE)
    axes.axhline(first, color=GREY, linestyle="--", linewidth=1)
    if best > first:
        axes.annotate("", (step, best), (step, first), arrowprops={"arrowstyle": "<->", "color": GREY})
    title = f"Validation MPSNR\nfirst {first:.2f} dB, best {best - first:+.2f} dB, last {last - first:+.2f} dB"
    calm(axes, "", "MPSNR (dB)", title)


def _draw_steps(axes: Axes, rows: Sequence[Row], column: str, **style: Any) -> None:
    kept = tables.complete(rows, "step", column)
    marker = "o" if len(kept) < 40 else ""
    axes.plot([row["step"] for row in kept], [row[column] for row in kept], marker=marker, markersize=3.5, **style)


def quality_by_plane(rows: Sequence[Row]) -> Figure:
    """PSNR and SSIM against alpha, the mean over light fields, a line per method and reference.

    Args:
        rows: Per plane: `method`, `reference`, `alpha`, `slope`, `psnr_db`, `ssim`.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    styles = _series_styles(rows)
    figure = new_figure(9, 4.6)
    for position, column in enumerate(("psnr_db", "ssim"), start=1):
        axes = figure.add_subplot(1, 2, position)
        kept = capped(tables.some(rows, "alpha", column), column)
        _draw_planes(axes, kept, column, styles)
        _label_slopes(axes, kept)
        calm(axes, wording.heading("alpha"), wording.heading(column), "")
    handles = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    figure.legend(handles=[*handles.values()], loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def _series_styles(rows: Sequence[Row]) -> dict[tuple[Any, ...], dict[str, Any]]:
    """How each method and reference is drawn: colour and marker say the method, dashes the reference."""
    tables.need(rows, "method", "reference")
    methods, references = tables.names(rows, "method"), tables.names(rows, "reference")
    return {
        (method, reference): {
            "color": METHOD_COLOURS[methods.index(method) % len(METHOD_COLOURS)],
            "marker": MARKERS[methods.index(method) % len(MARKERS)],
            "linestyle": DASHES[references.index(reference) % len(DASHES)],
            "label": f"{wording.drawable(method, 40)}\nagainst {wording.drawable(reference, 40)}",
        }
        for method, reference in tables.grouped(rows, "method", "reference")
    }


def _draw_planes(axes: Axes, rows: Sequence[Row], column: str, styles: Mapping[tuple[Any, ...], Any]) -> None:
    for series, group in tables.grouped(rows, "method", "reference").items():
        planes = sorted(tables.grouped(group, "alpha").items())
        means = [float(np.mean([row[column] for row in plane])) for _, plane in planes]
        axes.plot([alpha for (alpha,), _ in planes], means, markersize=5, **styles[series])
    fold_below_cap(axes)


def _label_slopes(axes: Axes, rows: Sequence[Row]) -> None:
    """Show along the upper edge which slope belongs to alpha; evenly spaced alphas are no evenly spaced slopes."""
    pairs = sorted({row["alpha"]: row["slope"] for row in tables.complete(rows, "alpha", "slope")}.items())
    shown = pairs[:: max(1, math.ceil(len(pairs) / 8))]
    upper = axes.secondary_xaxis("top")
    labels = [f"{slope:.2f}".replace("-", wording.MINUS) for _, slope in shown]
    upper.set_xticks([alpha for alpha, _ in shown], labels, fontsize=8, color=GREY)
    upper.set_xlabel(wording.heading("slope"), fontsize=9, color=GREY)
    upper.spines["top"].set_visible(False)


def scatter(rows: Sequence[Row]) -> Figure:
    """The paper's figure: MPSNR against MSSIM, a point per light field, coloured by reference, shaped by method.

    Args:
        rows: Evaluation summary: `method`, `reference`, `mpsnr_db`, `mssim`.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    styles = _series_styles(rows)
    kept = capped(tables.some(rows, "mpsnr_db", "mssim"), "mpsnr_db")
    figure = new_figure(7.5, 5)
    axes = figure.add_subplot()
    for (method, reference), group in tables.grouped(kept, "method", "reference").items():
        shape = {**styles[method, reference], "color": REFERENCE_COLOURS.get(reference, ORANGE), "linestyle": ""}
        x, y = [row["mssim"] for row in group], [row["mpsnr_db"] for row in group]
        axes.plot(x, y, markersize=6.5, alpha=0.75, **shape)
    fold_below_cap(axes)
    calm(axes, wording.heading("mssim"), wording.heading("mpsnr_db"), "One point per light field")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure
