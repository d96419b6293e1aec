"""Plots of training, sweeps, evaluations and benches; a PSNR counts in them by at most 70 dB, as in means."""

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from torch import Tensor

from lfref.bench.timing import FFT
from lfref.geometry import FocalPlanes
from lfref.report import drawing, pictures, tables
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, ORANGE, PALE, RED, TEAL, new_figure, style_axes

MOST_LINES, COLUMNS = 7, 4
"""Number of lines that a reader can follow in one panel, and of small panels in a row."""
LOSS_TERMS = {  # column of Lightning's metrics.csv: name, colour, line width
    "train/loss": ("total", BLACK, 1.8),
    "train/mse": ("MSE term", BLUE, 1.2),
    "train/l1": ("L1 term", TEAL, 1.2),
    "train/ssim": ("SSIM term", ORANGE, 1.2),
    "train/inverse_psnr": ("1/PSNR term", CYAN, 1.2),
    "val/loss": ("total, validation", RED, 1.8),
}


def training_curves(metrics: pd.DataFrame) -> Figure:
    """The loss with its terms, and validation MPSNR and MSSIM, of Lightning's metrics.csv."""
    figure = new_figure(9, 4.8)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1))
    losses, rise, similarity = (figure.add_subplot(part) for part in (grid[:, 0], grid[0, 1], grid[1, 1]))
    losses.set_yscale("log", nonpositive="mask")
    for column in (column for column in LOSS_TERMS if column in metrics):
        label, colour, width = LOSS_TERMS[column]
        _draw_steps(losses, metrics, column, color=colour, linewidth=width, label=label)
    figure.legend(loc="outside lower left", ncols=len(LOSS_TERMS), frameon=False, fontsize=9)
    style_axes(losses, "Optimiser step", "Loss (log scale)", "Loss and its terms")

    values = metrics["val/mpsnr"].dropna()
    first, best, last = values.iloc[0], values.max(), values.iloc[-1]
    _draw_steps(rise, metrics, "val/mpsnr", color=BLUE)
    rise.axhline(first, color=GREY, linestyle="--", linewidth=1)
    title = f"Validation MPSNR\nfirst {first:.2f} dB, best {best - first:+.2f} dB, last {last - first:+.2f} dB"
    style_axes(rise, "", "MPSNR (dB)", title)
    _draw_steps(similarity, metrics, "val/mssim", color=TEAL)
    style_axes(similarity, "Optimiser step", "MSSIM", "Validation MSSIM")
    return figure


def _draw_steps(axes: Axes, metrics: pd.DataFrame, column: str, **style: Any) -> None:
    rows = metrics.dropna(subset=["step", column])
    axes.plot(rows["step"], rows[column], marker="o" if len(rows) < 40 else "", markersize=3.5, **style)


def by_plane(planes: pd.DataFrame, columns: Iterable[str] = ("psnr_db",)) -> Figure:
    """Scores against alpha, or slope if a plane has no alpha: a part per class, reference and score, a line per method.

    More lines than a reader can follow get a panel each, in which all others are grey. A line is the mean over light
    fields; a method is left out where it is its own reference. `class` is a column if there are classes.
    """
    rows, place = tables.judged_by_others(planes), tables.plane_axis(planes)
    groups = list(rows.groupby([*(["class"] if "class" in rows else []), "reference"], sort=False))
    parts = [(*key, column, group) for key, group in groups for column in columns]
    n_lines = [group["method"].nunique() for *_, group in parts]
    heights = [3.8 if n <= MOST_LINES else 0.7 + 1.45 * math.ceil(n / COLUMNS) for n in n_lines]
    figure = new_figure(9, sum(heights) + 0.6)
    figures = figure.subfigures(len(parts), 1, squeeze=False, height_ratios=heights)[:, 0]
    for part, (*kind, reference, column, group) in zip(figures, parts, strict=True):
        title = tables.class_title(kind[0] if kind else tables.heading(column), reference)
        means = tables.capped(group, column).groupby(["method", place], sort=False)[column].mean().reset_index(place)
        lines = {
            tables.plot_text(method, 40): line.sort_values(place)
            for method, line in means.groupby("method", sort=False)
        }
        _draw_lines(part, lines, (place, column), (tables.heading(place), tables.score_label(column, reference)), title)
    return figure


def _draw_lines(
    figure: FigureBase, lines: Mapping[str, pd.DataFrame], columns: tuple[str, str], labels: tuple[str, str], title: str
) -> None:
    """Draw the two columns of each table as a line, all in one panel, or each in one of its own."""
    x, y = columns
    if len(lines) <= MOST_LINES:
        axes = figure.add_subplot()
        for index, (name, line) in enumerate(lines.items()):
            axes.plot(line[x], line[y], markersize=4, linewidth=1.2, label=name, **drawing.series_style(index))
        axes.legend(frameon=False, fontsize=8)
        style_axes(axes, *labels, title)
        return
    figure.suptitle(title, fontsize=10.5, x=0.01, ha="left", color=BLACK)
    figure.supxlabel(labels[0], fontsize=9)
    figure.supylabel(labels[1], fontsize=9)
    panels = figure.subplots(math.ceil(len(lines) / COLUMNS), COLUMNS, sharex=True, sharey=True).flat
    for axes in panels[len(lines) :]:
        axes.set_visible(False)
    for axes, (name, own) in zip(panels, lines.items(), strict=False):
        for line in lines.values():
            axes.plot(line[x], line[y], color=PALE, linewidth=0.8)
        axes.plot(own[x], own[y], "o-", color=BLUE, markersize=3)
        style_axes(axes, "", "", "")
        axes.set_title(name, fontsize=8, loc="left", color=BLACK, pad=3)


def scatter(summary: pd.DataFrame) -> Figure:
    """The paper's figure: MPSNR against MSSIM, a point per light field, coloured by reference, shaped by method.

    A method is left out where it is its own reference.
    """
    rows = tables.capped(tables.judged_by_others(summary), "mpsnr_db")
    methods, references = (rows[name].unique().tolist() for name in ("method", "reference"))
    figure = new_figure(7.5, 5)
    axes = figure.add_subplot()
    for (method, reference), group in rows.groupby(["method", "reference"], sort=False):
        style = {**drawing.series_style(methods.index(method)), "label": tables.plot_text(f"{method}, {reference}")}
        style["color"] = drawing.COLOURS[references.index(reference) % len(drawing.COLOURS)]
        axes.plot(group["mssim"], group["mpsnr_db"], linestyle="", markersize=6.5, alpha=0.75, **style)
    judge = references[0] if len(references) == 1 else "the reference"
    title = f"One point per light field, judged by {', '.join(references)}"
    style_axes(axes, tables.score_label("mssim", judge), tables.score_label("mpsnr_db", judge), title)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def front(rows: pd.DataFrame) -> Figure:
    """Accuracy against time: a panel per class, a point per method, and by the truth a step line, the Pareto front.

    Points of the front are full. Any other reference is the picture of a method: nearness to it is no quality, and
    there is no front. A method is left out where it is its own reference. The time of the row `FFT` is the unit.
    """
    unit = float(rows.loc[rows["method"] == FFT, "median_s"].iloc[0])
    methods = tables.judged_by_others(tables.capped(rows, "psnr_db")).dropna(subset=["median_s", "psnr_db"])
    times = methods[["median_s", "p10_s", "p90_s"]] / unit
    classes = list(methods.assign(**times).groupby(["class", "reference"], sort=False))
    figure = new_figure(9, 5.4 * len(classes))
    parts = figure.subfigures(len(classes), 1, squeeze=False)[:, 0]
    for part, ((name, reference), group) in zip(parts, classes, strict=True):
        is_truth = reference in tables.TRUTHS
        best = tables.pareto_front(group, "median_s", "psnr_db") if is_truth else group
        axes = part.subplots()
        axes.set_xscale("log")
        if is_truth:
            axes.step(best["median_s"], best["psnr_db"], where="post", color=CYAN, zorder=1)
        for index, row in enumerate(group.itertuples()):
            style = drawing.series_style(index) | ({} if row.Index in best.index else {"markerfacecolor": "white"})
            axes.hlines(row.psnr_db, row.p10_s, row.p90_s, color=style["color"], linewidth=1.2, alpha=0.6)
            axes.plot(row.median_s, row.psnr_db, linestyle="", label=tables.plot_text(row.method, 40), **style)
        axes.axvline(1, color=RED, linestyle="--", linewidth=1.2, zorder=0, label=f"NumPy 4-D FFT, {unit:.3g} s")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda time, _: f"{time:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        title = tables.class_title(name, reference)
        title += ": up and to the left is better" if is_truth else ": higher is nearer, not better"
        score = tables.score_label("psnr_db", reference)
        style_axes(axes, "Time, in NumPy's 4-D FFTs of the same views (log scale)", score, title)
        part.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def has_front(rows: pd.DataFrame) -> bool:
    """Whether a class is plotted: of one light field a table says all, and a method is not judged by itself."""
    several = "scenes" not in rows or bool((rows["scenes"] > 1).any())
    return several and not tables.judged_by_others(rows).dropna(subset=["median_s", "psnr_db"]).empty


def error_causes(by_plane: pd.DataFrame, panels_at: Collection[float] | None = None) -> Figure:
    """Bars for the cost of each cause, marks for what each remedy wins back; panels for the mean and for each plane.

    Costs are those of base methods; the other methods are remedies. `panels_at` are alphas, or slopes, of the planes
    that get a panel; None: all.
    """
    causes = by_plane["cause"].unique().tolist()[::-1]
    remedies = by_plane.loc[~by_plane["is_base"], "method"].unique().tolist()
    place = tables.plane_axis(by_plane)
    means = by_plane.groupby(["cause", "method", "is_base"], sort=False)[["cost_db", "won_db"]].mean().reset_index()
    shown = by_plane if panels_at is None else by_plane[by_plane[place].isin(panels_at)]
    panels = {"mean over planes": means}
    panels |= {f"{tables.heading(place)} {value:g}": rows for value, rows in shown.groupby(place)}
    figure = new_figure(2 + 2.6 * len(panels), 1.6 + 0.32 * len(causes))
    all_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (title, rows) in zip(all_axes, panels.items(), strict=True):
        is_base = rows["is_base"]
        costs = rows[is_base].groupby("cause")["cost_db"].first().reindex(causes)
        axes.barh(range(len(causes)), costs, height=0.62, color=CYAN, alpha=0.45, label="cost", zorder=1)
        for index, method in enumerate(remedies):
            won = rows[~is_base & (rows["method"] == method)].groupby("cause")["won_db"].first().reindex(causes)
            style = drawing.series_style(index) | {"label": f"won by {tables.plot_text(method, 40)}"}
            axes.plot(won, range(len(causes)), linestyle="", markersize=5, zorder=3, **style)
        axes.axvline(0, color=GREY, linewidth=0.8, zorder=2)
        axes.grid(axis="y", color=PALE)
        style_axes(axes, "dB", "", title)
    all_axes[0].set_yticks(range(len(causes)), causes)
    handles, labels = all_axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def comparison(stacks: Mapping[str, Tensor], planes: FocalPlanes, mean_image: Tensor) -> Figure:
    """The paper's comparison: a row per method, a column per plane, and a middle row with the mean of all views.

    Its planes are those of the least and of the greatest slope, and the one nearest to slope 0. The mean of all views,
    [C, H, W], sets the exposure of all pictures.
    """
    shown, slopes = [], planes.slopes
    for place in (slopes.argmin(), slopes.abs().argmin(), slopes.argmax()):
        shown += [int(place)] if int(place) not in shown else []
    middle, exposure = (len(stacks) + 1) // 2, pictures.common_exposure(mean_image)
    cell_height = 9 / len(shown) * mean_image.shape[-2] / mean_image.shape[-1] + 0.25  # inches
    figure = new_figure(9, max(cell_height, 0.6) * (len(stacks) + 1) + 0.3)
    figure.supxlabel(f"every picture: exposure \N{MULTIPLICATION SIGN} {exposure:.3g}", fontsize=8, color=GREY)
    grid = figure.subplots(len(stacks) + 1, len(shown), squeeze=False)
    for axes in grid.flat:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    centre = grid[middle, len(shown) // 2]
    centre.set_title("mean of all views, not refocused", fontsize=9)
    centre.imshow(pictures.for_display(mean_image, exposure))
    for line, (name, stack) in zip(np.delete(grid, middle, axis=0), stacks.items(), strict=True):
        line[0].set_ylabel(tables.plot_text(name, width=22), fontsize=10)
        for axes, plane in zip(line, shown, strict=True):
            axes.set_title(planes.labels[plane], fontsize=9)
            axes.imshow(pictures.for_display(stack[plane], exposure))
    return figure
