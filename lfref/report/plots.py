"""Plots of training, sweeps and evaluation; PSNR is capped at 100 dB.

A missing column, or one without numbers, raises an `InputError` that names it.
"""

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import MaxNLocator

from lfref.errors import InputError
from lfref.report import drawing, tables
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, ORANGE, RED, TEAL, fold_below_cap, new_figure, style_axes

METHOD_COLOURS = drawing.COLOURS[2:]
"""Colours of methods; blue and red are for references."""
DASHES = ("-", "--", ":", "-.")
REFERENCE_COLOURS = {"shift_and_sum": BLUE, "fourier_slice": RED, "exact_fourier": TEAL}
SERIES = ["method", "reference"]
"""Columns whose values name one line or cloud of points."""

LOSS_TERMS = {  # column of Lightning's metrics.csv: name, colour, line width
    "train/loss": ("total", BLACK, 1.8),
    "train/mse": ("MSE term", BLUE, 1.2),
    "train/l1": ("L1 term", TEAL, 1.2),
    "train/ssim": ("SSIM term", ORANGE, 1.2),
    "train/inverse_psnr": ("1/PSNR term", CYAN, 1.2),
    "val/loss": ("total, validation", RED, 1.8),
}


def training_curves(metrics: pd.DataFrame) -> Figure:
    """The loss with its terms, and validation MPSNR and MSSIM.

    Args:
        metrics: Lightning's metrics.csv: columns `step`, `val/mpsnr`, `val/mssim`, and those of the logged losses.
    """
    figure = new_figure(9, 4.8)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1))
    _draw_losses(figure.add_subplot(grid[:, 0]), metrics)
    _draw_rise(figure.add_subplot(grid[0, 1]), metrics)
    similarity = figure.add_subplot(grid[1, 1])
    _draw_steps(similarity, tables.require_numbers(metrics, "step", "val/mssim"), "val/mssim", color=TEAL)
    style_axes(similarity, "Optimiser step", "MSSIM", "Validation MSSIM")
    return figure


def _draw_losses(axes: Axes, metrics: pd.DataFrame) -> None:
    axes.set_yscale("log", nonpositive="mask")
    # A run shorter than its logging interval has only the losses of validation.
    for column, (label, colour, width) in LOSS_TERMS.items():
        if column in metrics:
            _draw_steps(axes, metrics, column, color=colour, linewidth=width, label=label)
    if not axes.get_lines():
        raise InputError("a training run must have logged a loss", got=f"columns {', '.join(metrics)}")
    axes.figure.legend(loc="outside lower left", ncols=len(LOSS_TERMS), frameon=False, fontsize=9)
    style_axes(axes, "Optimiser step", "Loss (log scale)", "Loss and its terms")


def _draw_rise(axes: Axes, metrics: pd.DataFrame) -> None:
    rows = tables.require_numbers(metrics, "step", "val/mpsnr")
    values = rows["val/mpsnr"]
    first, best, last, step = values.iloc[0], values.max(), values.iloc[-1], rows["step"][values.idxmax()]
    _draw_steps(axes, rows, "val/mpsnr", color=BLUE)
    axes.axhline(first, color=GREY, linestyle="--", linewidth=1)
    if best > first:
        axes.annotate("", (step, best), (step, first), arrowprops={"arrowstyle": "<->", "color": GREY})
    title = f"Validation MPSNR\nfirst {first:.2f} dB, best {best - first:+.2f} dB, last {last - first:+.2f} dB"
    style_axes(axes, "", "MPSNR (dB)", title)


def _draw_steps(axes: Axes, metrics: pd.DataFrame, column: str, **style: Any) -> None:
    rows = tables.with_numbers(metrics, "step", column)
    axes.plot(rows["step"], rows[column], marker="o" if len(rows) < 40 else "", markersize=3.5, **style)


KNOWN_METRICS = ("step", "epoch", "val/mpsnr", "val/mssim", *LOSS_TERMS)
"""Columns of metrics.csv that `training_curves` draws, or that hold no metrics."""
BY_PLANE = "val/mpsnr_plane/"
"""Beginning of the columns of metrics.csv with the MPSNR of a plane, such as `val/mpsnr_plane/alpha_0.5`."""


def validation_by_plane(metrics: pd.DataFrame) -> Figure | None:
    """MPSNR of each plane at the first, the best and the last validation; None if the planes were not logged.

    Args:
        metrics: Lightning's metrics.csv: columns `step`, `val/mpsnr`, and one for each plane.
    """
    columns = [column for column in metrics if column.startswith(BY_PLANE)]
    rows = tables.with_numbers(metrics, "step", "val/mpsnr", *columns)
    if rows.empty or not columns:
        return None
    quantity = columns[0].removeprefix(BY_PLANE).partition("_")[0]
    places = [float(column.rpartition("_")[2]) for column in columns]
    figure = new_figure(9, 3.4)
    axes = figure.add_subplot()
    shown = {"first": rows.iloc[0], "last": rows.iloc[-1], "best": rows.loc[rows["val/mpsnr"].idxmax()]}
    for (name, row), colour in zip(shown.items(), (GREY, ORANGE, BLUE), strict=True):
        label = f"{name}, step {row['step']:.0f}"
        axes.plot(places, row[columns].astype(float), "o-", color=colour, markersize=4, linewidth=1.3, label=label)
    axes.legend(frameon=False, fontsize=9)
    style_axes(axes, tables.heading(quantity), "MPSNR (dB)", "Validation MPSNR by plane")
    return figure


def sweep_curves(validations: pd.DataFrame, reference: str) -> Figure:
    """Validation MPSNR by step: a panel for each variant but the reference, which every panel shows in grey.

    Args:
        validations: Columns `variant`, `seed`, `step`, `val/mpsnr`; a row per validation of a run.
        reference: The variant to compare with.
    """
    rows = tables.require_numbers(validations, "step", "val/mpsnr")
    by_variant = {str(name): _over_seeds(group) for name, group in rows.groupby("variant", sort=False)}
    shown = [name for name in by_variant if name != reference] or [reference]
    n_columns, n_rows = min(3, len(shown)), math.ceil(len(shown) / 3)
    figure = new_figure(9, 0.5 + 2.4 * n_rows)
    grid = figure.subplots(n_rows, n_columns, squeeze=False, sharex=True, sharey=True)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for axes, name in zip(grid.flat, shown, strict=False):
        for each, colour in {reference: GREY, name: BLUE}.items():
            band = by_variant[each]
            axes.fill_between(band.index, band["min"], band["max"], color=colour, alpha=0.2, linewidth=0)
            marker = "o" if len(band) < 20 else ""
            axes.plot(band.index, band["mean"], color=colour, marker=marker, markersize=3, linewidth=1.4)
        style_axes(axes, "Optimiser step", "MPSNR (dB)", tables.plot_text(name, 34))
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        axes.label_outer()
    return figure


def _over_seeds(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean, least and most of the seeds at the steps that all of them have; at all steps if there are none."""
    statistics = rows.groupby("step")["val/mpsnr"].agg(["mean", "min", "max", "count"])
    complete = statistics[statistics["count"] == rows["seed"].nunique()]
    return statistics if complete.empty else complete


def quality_by_plane(planes: pd.DataFrame) -> Figure:
    """PSNR and SSIM against alpha, or slope if a plane has no alpha: means over light fields, a line per series.

    Args:
        planes: Columns `method`, `reference`, `alpha`, `slope`, `psnr_db`, `ssim`; a row per plane of each light field.
    """
    tables.require(planes, *SERIES, "alpha", "slope")
    place, planes = tables.plane_axis(planes), _with_dashes(planes)
    styles, shown = _styles(planes), tables.judged_by_others(planes)
    n_lines = len(shown.groupby(SERIES))
    is_split = n_lines > drawing.MOST_LINES
    figure = new_figure(9, 2 * drawing.curves_height(n_lines) if is_split else 4.6)
    parts = figure.subfigures(*(2, 1) if is_split else (1, 2), squeeze=False).flat
    for part, column in zip(parts, ("psnr_db", "ssim"), strict=True):
        rows = tables.capped(tables.require_numbers(shown, place, column), column)
        means = rows.groupby([*SERIES, place], sort=False)[column].mean().reset_index(place)
        curves = {
            styles[series]["label"]: (line[place], line[column], styles[series] | {"markersize": 5})
            for series, line in means.groupby(SERIES, sort=False)
        }
        _draw_by_plane(part, curves, rows, column, _judged_by(rows, column), "")
    _add_legend(figure, 2)
    return figure


def psnr_by_plane(planes: pd.DataFrame) -> Figure:
    """PSNR against alpha, or slope if a plane has no alpha: a panel per class, a line per method.

    More methods than a panel can hold have a panel each. A method is left out where it is its own reference.

    Args:
        planes: Columns `class`, `method`, `reference`, `alpha`, `slope`, `psnr_db`; a row per plane of each method and
            class.
    """
    tables.require(planes, "class", *SERIES, "alpha", "slope")
    place = tables.plane_axis(planes)
    rows = tables.capped(tables.require_numbers(tables.judged_by_others(planes), place, "psnr_db"), "psnr_db")
    classes, methods = list(rows.groupby(["class", "reference"], sort=False)), rows["method"].unique().tolist()
    heights = [drawing.curves_height(group["method"].nunique()) for _, group in classes]
    figure = new_figure(9, 1.2 + sum(heights))
    parts = figure.subfigures(len(classes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for part, ((name, reference), group) in zip(parts, classes, strict=True):
        curves = {
            tables.plot_text(method, 40): (
                line[place],
                line["psnr_db"],
                drawing.series_style(methods.index(method)) | {"markersize": 4, "linewidth": 1.2},
            )
            for method, line in group.sort_values(place, kind="stable").groupby("method", sort=False)
        }
        label = tables.score_label("psnr_db", reference)
        _draw_by_plane(part, curves, group, "psnr_db", label, tables.class_title(name, reference))
    _add_legend(figure, 3)
    return figure


def _draw_by_plane(
    part: FigureBase, curves: Mapping[str, drawing.Curve], rows: pd.DataFrame, column: str, label: str, title: str
) -> None:
    place = tables.plane_axis(rows)
    panels = drawing.draw_curves(part, curves, tables.heading(place), label, title)
    for axes in panels:
        if column.endswith("psnr_db"):
            fold_below_cap(axes)
    if place == "alpha" and len(panels) == 1:
        _label_slopes(panels[0], rows)


def _add_legend(figure: Figure, n_columns: int) -> None:
    """One legend below all panels; small panels have their names as titles instead."""
    handles = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    named = [line for label, line in handles.items() if not str(label).startswith("_")]
    if named:
        figure.legend(handles=named, loc="outside lower center", ncols=n_columns, frameon=False, fontsize=9)


def _judged_by(rows: pd.DataFrame, column: str) -> str:
    """Label of an axis for a score by one reference, or by several, of which not all are the truth."""
    references = rows["reference"].unique().tolist()
    return tables.score_label(column, references[0] if len(references) == 1 else "the reference")


def _with_dashes(table: pd.DataFrame) -> pd.DataFrame:
    """The table with a dash in place of a missing name."""
    return table.fillna(dict.fromkeys(SERIES, tables.DASH))


def _styles(table: pd.DataFrame) -> dict[Any, dict[str, Any]]:
    """Style of each method (colour and marker) and reference (dashes)."""
    methods, references = (table[column].unique().tolist() for column in SERIES)
    return {
        (method, reference): {
            **drawing.series_style(methods.index(method), METHOD_COLOURS),
            "linestyle": DASHES[references.index(reference) % len(DASHES)],
            "label": f"{tables.plot_text(method, 40)}\nagainst {tables.plot_text(reference, 40)}",
        }
        for method, reference in table.groupby(SERIES, sort=False).groups
    }


def _label_slopes(axes: Axes, planes: pd.DataFrame) -> None:
    """Label the upper edge with slopes: even steps of alpha are not even steps of slope."""
    slopes = planes.groupby("alpha")["slope"].first()
    shown = slopes.iloc[:: max(1, math.ceil(len(slopes) / 8))]
    upper = axes.secondary_xaxis("top")
    labels = [f"{slope:.2f}".replace("-", tables.MINUS) for slope in shown]
    upper.set_xticks(shown.index, labels, fontsize=8, color=GREY)
    upper.set_xlabel(tables.heading("slope"), fontsize=9, color=GREY)
    upper.spines["top"].set_visible(False)


def scatter(summary: pd.DataFrame) -> Figure:
    """The paper's figure: MPSNR against MSSIM, a point per light field, coloured by reference, shaped by method.

    A method is left out where it is its own reference.

    Args:
        summary: Summary of an evaluation: columns `method`, `reference`, `mpsnr_db`, `mssim`.
    """
    tables.require(summary, *SERIES)
    judged = tables.judged_by_others(_with_dashes(summary))
    rows = tables.capped(tables.require_numbers(judged, "mpsnr_db", "mssim"), "mpsnr_db")
    styles = _styles(_with_dashes(summary))
    figure = new_figure(7.5, 5)
    axes = figure.add_subplot()
    for series, group in rows.groupby(SERIES, sort=False):
        shape = {**styles[series], "color": REFERENCE_COLOURS.get(series[1], ORANGE), "linestyle": ""}
        axes.plot(group["mssim"], group["mpsnr_db"], markersize=6.5, alpha=0.75, **shape)
    fold_below_cap(axes)
    is_truth = rows["reference"].isin(tables.TRUTHS)
    judges = "the truth" if is_truth.all() else f"label sources and {'' if is_truth.any() else 'not '}by the truth"
    title = f"One point per light field, judged by {judges}"
    style_axes(axes, _judged_by(rows, "mssim"), _judged_by(rows, "mpsnr_db"), title)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure
