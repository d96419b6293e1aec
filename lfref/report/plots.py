"""Plots of trainings, evaluations, benches and hard cases; a PSNR counts in them by at most 70 dB, as in means."""

import math
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from torch import Tensor

from lfref.bench import accuracy
from lfref.bench.timing import FFT
from lfref.geometry import FocalPlanes
from lfref.report import drawing, pictures, tables
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, MAGENTA, ORANGE, PALE, RED, TEAL, new_figure, style_axes

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
OUTCOMES = {
    "holds": (TEAL, "within the tolerance"),
    "inexact": (ORANGE, "beyond the tolerance"),
    "not finite": (BLACK, "value or gradient not finite"),
    "hidden": (MAGENTA, "finite where the input is not"),
    "error": (GREY, "fails with an error"),
}
"""Outcome of a trial -> colour and meaning."""
MOST_PANELS = 4
CELL, HEADER, SIDE = 0.17, 1.35, 2.4


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
    """Scores against alpha or slope: a part per class, reference and score, a line or a panel per method."""
    rows, place = tables.judged_by_others(planes), tables.plane_axis(planes)
    groups = list(rows.groupby([*(["class"] if "class" in rows else []), "reference"], sort=False))
    parts = [(*key, column, group) for key, group in groups for column in columns]
    n_lines = [group["method"].nunique() for *_, group in parts]
    heights = [3.8 if n <= MOST_LINES else 0.7 + 1.45 * math.ceil(n / COLUMNS) for n in n_lines]
    figure = new_figure(9, sum(heights) + 0.6)
    figures = figure.subfigures(len(parts), 1, squeeze=False, height_ratios=heights)[:, 0]
    for part, (*kind, reference, column, group) in zip(figures, parts, strict=True):
        title = tables.class_title(kind[0] if kind else tables.heading(column), reference)
        means = accuracy.capped(group, column).groupby(["method", place], sort=False)[column].mean().reset_index(place)
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
    """The paper's figure: MPSNR against MSSIM, a point per light field, coloured by reference, shaped by method."""
    rows = accuracy.capped(tables.judged_by_others(summary), "mpsnr_db")
    methods, references = (rows[name].unique().tolist() for name in ("method", "reference"))
    figure = new_figure(7.5, 5)
    axes = figure.add_subplot()
    for (method, reference), group in rows.groupby(["method", "reference"], sort=False):
        style = {**drawing.series_style(methods.index(method)), "label": tables.plot_text(f"{method}, {reference}")}
        style["color"] = drawing.COLOURS[references.index(reference) % len(drawing.COLOURS)]
        axes.plot(group["mssim"], group["mpsnr_db"], linestyle="", markersize=6.5, alpha=0.75, **style)
    judge = references[0] if len(references) == 1 else "the reference"
    title = f"One point per light field, against {', '.join(references)}"
    style_axes(axes, tables.score_label("mssim", judge), tables.score_label("mpsnr_db", judge), title)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def front(rows: pd.DataFrame) -> Figure:
    """Accuracy against time: a panel per class, a point per method, and the Pareto front against the truth.

    Points of the front are full. Nearness to any other reference, the picture of a method, is no quality.
    """
    unit_ms = 1e3 * float(rows.loc[rows["method"] == FFT, "median_s"].iloc[0])
    methods = tables.judged_by_others(accuracy.capped(rows, "psnr_db")).dropna(subset=["median_s", "psnr_db"])
    times = 1e3 * methods[["median_s", "p10_s", "p90_s"]]
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
        axes.axvline(unit_ms, color=RED, linestyle="--", linewidth=1.2, zorder=0, label="NumPy 4-D FFT, unit of tables")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda time, _: f"{time:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        title = tables.class_title(name, reference)
        title += ": up and to the left is better" if is_truth else ": higher is nearer, not better"
        score = tables.score_label("psnr_db", reference)
        style_axes(axes, "Time of the whole stack, in milliseconds (log scale)", score, title)
        part.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def has_front(rows: pd.DataFrame) -> bool:
    """Whether a class is plotted: of one light field a table says all, and a method is not judged by itself."""
    several = "scenes" not in rows or bool((rows["scenes"] > 1).any())
    return several and not tables.judged_by_others(rows).dropna(subset=["median_s", "psnr_db"]).empty


def error_causes(by_plane: pd.DataFrame, panels_at: Collection[float] | None = None) -> Figure:
    """Bars for the cost of each cause, marks for what each remedy wins back; panels for the mean and for each plane.

    `panels_at` are alphas, or slopes, of the planes that get a panel; None: all.
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
    """The paper's comparison: a row per method, columns of the least, middle and greatest slope, the mean of views."""
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


def heat_maps(trials: pd.DataFrame) -> dict[str, Figure]:
    """Caption -> heat map of up to `MOST_PANELS` components that follow each other and have the same cases."""
    cases = {str(name): set(panel["case"]) for name, panel in trials.groupby("component", sort=False)}
    pictures: list[list[str]] = []
    for name in cases:
        if not pictures or len(pictures[-1]) == MOST_PANELS or not cases[name] <= cases[pictures[-1][0]]:
            pictures.append([])
        pictures[-1].append(name)
    return {", ".join(names): heat_map(trials[trials["component"].isin(names)]) for names in pictures}


def heat_map(trials: pd.DataFrame) -> Figure:
    """One panel per component of `component, case, precision, formulation, outcome`, all with the same cases."""
    panels, cases = dict(list(trials.groupby("component", sort=False))), trials["case"].unique().tolist()
    widths = [len(panel.groupby(["formulation", "precision"])) for panel in panels.values()]
    figure = new_figure(SIDE + CELL * sum(widths) + 0.3 * len(widths), HEADER + CELL * len(cases) + 0.6)
    all_axes = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
    for axes, (component, panel) in zip(all_axes, panels.items(), strict=True):
        _draw_panel(axes, str(component), panel, cases)
    for axes in all_axes[1:]:
        axes.set_yticklabels([])
    shown = {text: to_rgb(colour) for name, (colour, text) in OUTCOMES.items() if name in set(trials["outcome"])}
    handles = [Patch(color=colour, label=text) for text, colour in shown.items()]
    figure.legend(handles=handles, loc="outside lower left", ncols=3, frameon=False, fontsize=8)
    return figure


def _draw_panel(axes: Axes, component: str, panel: pd.DataFrame, cases: Sequence[str]) -> None:
    pairs = panel[["formulation", "precision"]].drop_duplicates()
    # All precisions of one formulation, then of the next.
    columns = pd.concat([own for _, own in pairs.groupby("formulation", sort=False)], ignore_index=True)
    places = pd.MultiIndex.from_frame(columns)
    cells = np.ones((len(cases), len(columns), 3))
    for row in panel.itertuples():
        cells[cases.index(row.case), places.get_loc((row.formulation, row.precision))] = to_rgb(
            OUTCOMES[row.outcome][0]
        )
    axes.imshow(cells, aspect="equal", interpolation="nearest")
    # A column is nearly three letters wide.
    axes.set_title(textwrap.fill(component, round(2.8 * len(columns)) + 2), fontsize=8.5, loc="left", color=BLACK)
    axes.set_yticks(range(len(cases)), cases, fontsize=8)
    axes.set_xticks(columns.index, columns["precision"], rotation=90, fontsize=7)
    axes.tick_params(top=True, labeltop=True, bottom=False, labelbottom=False, length=0, color=GREY)
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(cases) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.7)
    axes.tick_params(which="minor", length=0)
    axes.spines[:].set_visible(False)
    # Each name stands below its columns, with a line between one name and the next.
    for place, name in columns["formulation"].drop_duplicates().items():
        axes.text(place - 0.4, -0.01, name, fontsize=7.5, va="top", transform=axes.get_xaxis_transform(), color=BLACK)
        if place:
            axes.axvline(place - 0.5, color=BLACK, linewidth=1.5)
