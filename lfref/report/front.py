"""Accuracy against time: every method a labelled point, the front of those that nothing beats drawn as a line.

Labels are placed where they meet nothing else.
"""

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.path import Path as MplPath
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox, BboxBase

from lfref.report import tables, wording
from lfref.report.drawing import BLUE, CYAN, GREY, RED, calm, fold_below_cap, new_figure

COLUMNS = ["method", "median_s", "p10_s", "p90_s", "psnr_db"]
TURNS = (0, 8, 4, 12, 2, 6, 10, 14, 1, 7, 9, 15)  # sixteenths: where a label goes beside its point, best first
DIRECTIONS = [np.array([math.cos(math.tau * turn / 16), math.sin(math.tau * turn / 16)]) for turn in TURNS]
LEADER = {"arrowstyle": "-", "color": GREY, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 7}
CENTRED: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 9, "arrowprops": LEADER}


def accuracy_time(methods: pd.DataFrame, fft_seconds: float | None = None) -> Figure:
    """Accuracy against time, every method named, the methods that no other beats joined by a step line.

    Args:
        methods: `method`, `median_s`, `psnr_db`, one row a method that was judged; `p10_s` and `p90_s` are drawn where
            they are there.
        fft_seconds: Time of NumPy's 4-D FFT of the three channels in the same run, drawn as a line.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    tables.need(methods, "method")
    kept = tables.capped(tables.some(methods, "median_s", "psnr_db"), "psnr_db").reindex(columns=COLUMNS)
    kept = kept[kept["median_s"].between(0, math.inf, inclusive="neither")]
    best = tables.front(kept, "median_s", "psnr_db")
    figure = new_figure(9, 5.4)
    axes = figure.add_subplot(xscale="log")
    axes.plot(np.repeat(best["median_s"], 2)[1:], np.repeat(best["psnr_db"], 2)[:-1], color=CYAN, zorder=1)
    for row in kept.itertuples():
        colour = BLUE if row.Index in best.index else GREY
        if row.p10_s > 0 and row.p90_s < math.inf:
            axes.plot([row.p10_s, row.p90_s], [row.psnr_db] * 2, color=colour, linewidth=1.2, alpha=0.6)
        axes.plot(row.median_s, row.psnr_db, "o", color=colour, markersize=7, zorder=3)
    calm(axes, "Time, median (log scale)", "PSNR (dB)", "Accuracy against time: up and to the left is better", 20)
    if fft_seconds is not None:
        _draw_landmark(axes, fft_seconds)
    _frame_times(axes)
    fold_below_cap(axes)
    figure.draw_without_rendering()  # settles the layout, which the labels' places in pixels depend on
    _label_points(axes, kept)
    return figure


def _draw_landmark(axes: Axes, seconds: float) -> None:
    axes.axvline(seconds, color=RED, linestyle="--", linewidth=1.2, zorder=0)
    where = axes.get_xaxis_transform()
    axes.text(seconds, 1.01, f"NumPy 4-D FFT, {seconds:.3g} s", transform=where, ha="center", fontsize=9, color=RED)


def _frame_times(axes: Axes) -> None:
    """Limits with room for labels and at least a decade and a half, so that labelled ticks are in sight."""
    times = np.log10(np.concatenate([line.get_xdata() for line in axes.get_lines()]))
    margin = max(0.12 * np.ptp(times), 0.75 - np.ptp(times) / 2, 0.2)
    axes.set_xlim(10 ** (times.min() - margin), 10 ** (times.max() + margin))
    axes.margins(y=0.1)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if np.ptp(times) < 3 else (1,)))
    axes.xaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _label_points(axes: Axes, methods: pd.DataFrame) -> None:
    """Write each method at the nearest place where it meets no other label, line, point or edge, if there is one."""
    places = methods[["median_s", "psnr_db"]].to_numpy(float)
    points = axes.transData.transform(places)
    taken = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in points]
    paths = [line.get_transform().transform_path(line.get_path()) for line in axes.get_lines()]
    for name, where, point in zip(methods["method"], places, points, strict=True):
        text = axes.annotate(wording.drawable(name), where, (0, 0), "data", "offset points", **CENTRED)
        place = _free_place(axes.bbox, point, text.get_window_extent(), taken, paths)
        text.xyann = (np.array(place.p0 + place.p1) / 2 - point) * 72 / axes.figure.dpi
        text.set_in_layout(False)
        taken.append(place)


def _free_place(frame: BboxBase, point: np.ndarray, size: BboxBase, taken: list[Bbox], paths: list[MplPath]) -> Bbox:
    """The box of that size around the point that overlaps least with what is there, and near before far."""
    half = np.array([size.width, size.height]) / 2

    def cost(place: Bbox) -> float:
        crossed = sum(path.intersects_bbox(place, filled=False) for path in paths)
        away = math.hypot(*np.maximum(abs(np.mean(place.get_points(), axis=0) - point) - half, 0))
        outside = not (frame.contains(*place.p0) and frame.contains(*place.p1))
        return 10 * place.count_overlaps(taken) + 30 * outside + crossed + away / 50

    centres = [point + towards * (radius + half) for radius in range(9, 140, 10) for towards in DIRECTIONS]
    return min((Bbox([centre - half, centre + half]) for centre in centres), key=cost)
