"""Accuracy against time: every method is a labelled point; where the truth is known, a line joins the Pareto front.

Any other reference is the picture of a method: nearness to it is no quality, and there is no front. The unit of time is
the paper's: NumPy's 4-D FFT of the same views. This module stands alone because it searches places where labels overlap
nothing.
"""

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.path import Path as MplPath
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox, BboxBase

from lfref.bench.timing import FFT
from lfref.errors import InputError
from lfref.report import tables
from lfref.report.drawing import BLUE, CYAN, GREY, RED, fold_below_cap, new_figure, style_axes

SPANS = ["median_s", "p10_s", "p90_s"]
TURNS = (0, 8, 4, 12, 2, 6, 10, 14, 1, 7, 9, 15)  # sixteenths of a turn: directions of labels from points, best first
DIRECTIONS = [np.array([math.cos(math.tau * turn / 16), math.sin(math.tau * turn / 16)]) for turn in TURNS]
LEADER = {"arrowstyle": "-", "color": GREY, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 7}
CENTRED: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 9, "arrowprops": LEADER}


def accuracy_time(rows: pd.DataFrame) -> Figure:
    """A panel per class, a labelled point per method, and by the truth a step line along the Pareto front.

    A method is left out where it is its own reference.

    Args:
        rows: Columns `method`, `class`, `reference`, `median_s`, `psnr_db`; a row per method and class, and a row of
            method `FFT`, whose time is the unit; `p10_s` and `p90_s` are drawn if they exist.

    Raises:
        InputError: One of these columns is missing, or has no number; or the row of the FFT is missing.
    """
    tables.require(rows, "method", "median_s", "class", "reference")
    fft_s = tables.with_numbers(rows, "median_s").loc[lambda timed: timed["method"] == FFT, "median_s"]
    if fft_s.empty:
        raise InputError(f"the table must have the time of {FFT}, which is the unit", got="no such row")
    unit = float(fft_s.iloc[0])
    by_others = tables.judged_by_others(rows)
    methods = tables.capped(tables.require_numbers(by_others, "median_s", "psnr_db"), "psnr_db")
    methods = methods.reindex(columns=["method", "class", "reference", *SPANS, "psnr_db"])
    methods = methods[methods["median_s"].between(0, math.inf, inclusive="neither")]
    in_units = methods.assign(**{column: methods[column] / unit for column in SPANS})
    classes = list(in_units.groupby(["class", "reference"], sort=False, dropna=False))
    figure = new_figure(9, 0.6 + 4.5 * len(classes))
    panels = figure.subplots(len(classes), squeeze=False)[:, 0]
    for axes, ((name, reference), methods) in zip(panels, classes, strict=True):
        axes.set_xscale("log")
        _draw_points(axes, methods, has_front=reference in tables.TRUTHS)
        title = tables.class_title(name, reference)
        title += ": up and to the left is better" if reference in tables.TRUTHS else ": higher is nearer, not better"
        score = tables.score_label("psnr_db", reference)
        style_axes(axes, "Time, in NumPy's 4-D FFTs of the same views (log scale)", score, title, 20)
        axes.axvline(1, color=RED, linestyle="--", linewidth=1.2, zorder=0)
        name, where = f"NumPy 4-D FFT, {unit:.3g} s", axes.get_xaxis_transform()
        axes.text(1, 1.01, name, transform=where, ha="center", fontsize=9, color=RED)
        _frame_times(axes)
        fold_below_cap(axes)
    figure.draw_without_rendering()  # fixes the layout; the labels' places in pixels depend on it
    for axes, (_, methods) in zip(panels, classes, strict=True):
        _label_points(axes, methods)
    return figure


def has_plot(rows: pd.DataFrame) -> bool:
    """Whether a class is plotted: of one light field a table says all, and a method is not judged by itself."""
    several = "scenes" not in rows or bool((rows["scenes"] > 1).any())
    return several and not tables.with_numbers(tables.judged_by_others(rows), "median_s", "psnr_db").empty


def _draw_points(axes: Axes, methods: pd.DataFrame, has_front: bool) -> None:
    best = tables.pareto_front(methods, "median_s", "psnr_db") if has_front else methods
    if has_front:
        axes.plot(np.repeat(best["median_s"], 2)[1:], np.repeat(best["psnr_db"], 2)[:-1], color=CYAN, zorder=1)
    for row in methods.itertuples():
        colour = BLUE if row.Index in best.index else GREY
        if row.p10_s > 0 and row.p90_s < math.inf:
            axes.plot([row.p10_s, row.p90_s], [row.psnr_db] * 2, color=colour, linewidth=1.2, alpha=0.6)
        axes.plot(row.median_s, row.psnr_db, "o", color=colour, markersize=7, zorder=3)


def _frame_times(axes: Axes) -> None:
    """Set limits with room for labels, at least a decade and a half apart, so that some ticks have labels."""
    times = np.log10(np.concatenate([line.get_xdata() for line in axes.get_lines()]))
    margin = max(0.12 * np.ptp(times), 0.75 - np.ptp(times) / 2, 0.2)
    axes.set_xlim(10 ** (times.min() - margin), 10 ** (times.max() + margin))
    axes.margins(y=0.1)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if np.ptp(times) < 3 else (1,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda units, place: f"{units:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _label_points(axes: Axes, methods: pd.DataFrame) -> None:
    """Write each method's name at the nearest place where it overlaps no other label, line, point or edge."""
    places = methods[["median_s", "psnr_db"]].to_numpy(float)
    points = axes.transData.transform(places)
    occupied = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in points]
    paths = [line.get_transform().transform_path(line.get_path()) for line in axes.get_lines()]
    for name, where, point in zip(methods["method"], places, points, strict=True):
        text = axes.annotate(tables.plot_text(name), where, (0, 0), "data", "offset points", **CENTRED)
        place = _free_place(axes.bbox, point, text.get_window_extent(), occupied, paths)
        text.xyann = (np.array(place.p0 + place.p1) / 2 - point) * 72 / axes.figure.dpi
        text.set_in_layout(False)
        occupied.append(place)


def _free_place(frame: BboxBase, point: np.ndarray, size: BboxBase, occupied: list[Bbox], paths: list[MplPath]) -> Bbox:
    """The box of that size near the point that overlaps least; among equal ones, the nearest."""
    half = np.array([size.width, size.height]) / 2

    def cost(place: Bbox) -> float:
        crossed = sum(path.intersects_bbox(place, filled=False) for path in paths)
        away = math.hypot(*np.maximum(abs(np.mean(place.get_points(), axis=0) - point) - half, 0))
        outside = not (frame.contains(*place.p0) and frame.contains(*place.p1))
        return 10 * place.count_overlaps(occupied) + 30 * outside + crossed + away / 50

    centres = [point + towards * (radius + half) for radius in range(9, 140, 10) for towards in DIRECTIONS]
    return min((Bbox([centre - half, centre + half]) for centre in centres), key=cost)
