"""Plots of results, each a matplotlib Figure that needs neither a display nor pyplot's global state.

Colours are ones that colour-blind readers tell apart (Tol, "Colour schemes", SRON 2021, scheme "vibrant").
PSNR is capped at 100 dB; where a plot has capped and other values, the empty stretch between them is folded together.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.path import Path as MplPath
from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator, NullFormatter
from matplotlib.transforms import Bbox, BboxBase

from lfref.io import atomic
from lfref.report import tables
from lfref.report.tables import CAP_DB, Row

BLUE, RED, TEAL, ORANGE, MAGENTA, CYAN = "#0077BB", "#CC3311", "#009988", "#EE7733", "#EE3377", "#33BBEE"
BLACK, GREY, PALE = "#222222", "#767676", "#DDDDDD"
TURNS = (0, 8, 4, 12, 2, 6, 10, 14, 1, 7, 9, 15)  # sixteenths: where a label goes beside its point, best first
METHOD_COLOURS = (TEAL, ORANGE, BLACK, CYAN, MAGENTA, GREY)  # blue and red are for references
MARKERS = ("o", "^", "s", "D", "v", "P", "X", "<", ">", "p", "h", "*")
DASHES = ("-", "--", ":", "-.")
DIRECTIONS = [np.array([math.cos(math.tau * turn / 16), math.sin(math.tau * turn / 16)]) for turn in TURNS]
REFERENCE_COLOURS = {"shift_and_sum": BLUE, "fourier_slice": RED, "exact_fourier": TEAL}
PNG: dict[str, Any] = {"format": "png", "dpi": 150, "bbox_inches": "tight", "pad_inches": 0.12}
LEADER = {"arrowstyle": "-", "color": GREY, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 7}
CENTRED: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 9, "arrowprops": LEADER}

LOSS_TERMS = {  # column of Lightning's metrics.csv: name, colour, line width
    "train/loss": ("total", BLACK, 1.8),
    "train/mse": ("MSE term", BLUE, 1.2),
    "train/l1": ("L1 term", TEAL, 1.2),
    "train/ssim": ("SSIM term", ORANGE, 1.2),
    "train/inverse_psnr": ("1/PSNR term", CYAN, 1.2),
    "val/loss": ("total, validation", RED, 1.8),
}


def new_figure(width: float, height: float) -> Figure:
    """An empty white figure on the Agg canvas, sizes in inches."""
    figure = Figure(figsize=(width, height), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write the figure as a PNG file, all or nothing, cut to what is drawn."""
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, **PNG)


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
    _calm(similarity, "Optimiser step", "MSSIM", "Validation MSSIM")
    return figure


def _draw_losses(axes: Axes, rows: Sequence[Row]) -> None:
    axes.set_yscale("log", nonpositive="mask")
    tables.some(rows, "train/loss")
    for column, (label, colour, width) in LOSS_TERMS.items():
        if column in tables.columns_of(rows):
            _draw_steps(axes, rows, column, color=colour, linewidth=width, label=label)
    axes.figure.legend(loc="outside lower left", ncols=len(LOSS_TERMS), frameon=False, fontsize=9)
    _calm(axes, "Optimiser step", "Loss (log scale)", "Loss and its terms")


def _draw_rise(axes: Axes, rows: Sequence[Row]) -> None:
    kept = tables.some(rows, "step", "val/mpsnr")
    first, last = kept[0]["val/mpsnr"], kept[-1]["val/mpsnr"]
    step, best = max(((row["step"], row["val/mpsnr"]) for row in kept), key=lambda point: point[1])
    _draw_steps(axes, rows, "val/mpsnr", color=BLUE)
    axes.axhline(first, color=GREY, linestyle="--", linewidth=1)
    if best > first:
        axes.annotate("", (step, best), (step, first), arrowprops={"arrowstyle": "<->", "color": GREY})
    title = f"Validation MPSNR\nfirst {first:.2f} dB, best {best - first:+.2f} dB, last {last - first:+.2f} dB"
    _calm(axes, "", "MPSNR (dB)", title)


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
        kept = _capped(tables.some(rows, "alpha", column), column)
        _draw_planes(axes, kept, column, styles)
        _label_slopes(axes, kept)
        _calm(axes, tables.heading("alpha"), tables.heading(column), "")
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
            "label": f"{tables.drawable(method, 40)}\nagainst {tables.drawable(reference, 40)}",
        }
        for method, reference in tables.grouped(rows, "method", "reference")
    }


def _draw_planes(axes: Axes, rows: Sequence[Row], column: str, styles: Mapping[tuple[Any, ...], Any]) -> None:
    for series, group in tables.grouped(rows, "method", "reference").items():
        planes = sorted(tables.grouped(group, "alpha").items())
        means = [float(np.mean([row[column] for row in plane])) for _, plane in planes]
        axes.plot([alpha for (alpha,), _ in planes], means, markersize=5, **styles[series])
    _fold_below_cap(axes)


def _label_slopes(axes: Axes, rows: Sequence[Row]) -> None:
    """Show along the upper edge which slope belongs to alpha; evenly spaced alphas are no evenly spaced slopes."""
    pairs = sorted({row["alpha"]: row["slope"] for row in tables.complete(rows, "alpha", "slope")}.items())
    shown = pairs[:: max(1, math.ceil(len(pairs) / 8))]
    upper = axes.secondary_xaxis("top")
    labels = [f"{slope:.2f}".replace("-", tables.MINUS) for _, slope in shown]
    upper.set_xticks([alpha for alpha, _ in shown], labels, fontsize=8, color=GREY)
    upper.set_xlabel(tables.heading("slope"), fontsize=9, color=GREY)
    upper.spines["top"].set_visible(False)


def scatter(rows: Sequence[Row]) -> Figure:
    """The paper's figure: MPSNR against MSSIM, a point per light field, coloured by reference, shaped by method.

    Args:
        rows: Evaluation summary: `method`, `reference`, `mpsnr_db`, `mssim`.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    styles = _series_styles(rows)
    kept = _capped(tables.some(rows, "mpsnr_db", "mssim"), "mpsnr_db")
    figure = new_figure(7.5, 5)
    axes = figure.add_subplot()
    for (method, reference), group in tables.grouped(kept, "method", "reference").items():
        shape = {**styles[method, reference], "color": REFERENCE_COLOURS.get(reference, ORANGE), "linestyle": ""}
        x, y = [row["mssim"] for row in group], [row["mpsnr_db"] for row in group]
        axes.plot(x, y, markersize=6.5, alpha=0.75, **shape)
    _fold_below_cap(axes)
    _calm(axes, tables.heading("mssim"), tables.heading("mpsnr_db"), "One point per light field")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def accuracy_time(rows: Sequence[Row], fft_seconds: float | None = None) -> Figure:
    """Accuracy against time, every method named, the methods that no other beats joined by a step line.

    Args:
        rows: `method`, `median_s`, `psnr_db`, one row a method; `p10_s` and `p90_s` are drawn where they are there.
        fft_seconds: Time of NumPy's 4-D FFT of the three channels in the same run, drawn as a line.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    tables.need(rows, "method")
    timed = [row for row in tables.some(rows, "median_s", "psnr_db") if 0 < row["median_s"] < math.inf]
    kept = _capped(timed, "psnr_db")
    best = tables.front(kept, "median_s", "psnr_db")
    figure = new_figure(9, 5.4)
    axes = figure.add_subplot(xscale="log")
    times, gains = [row["median_s"] for row in best], [row["psnr_db"] for row in best]
    axes.plot(np.repeat(times, 2)[1:], np.repeat(gains, 2)[:-1], color=CYAN, zorder=1)
    for row in kept:
        _draw_time(axes, row, BLUE if row in best else GREY)
    _calm(axes, "Time, median (log scale)", "PSNR (dB)", "Accuracy against time: up and to the left is better", 20)
    if fft_seconds is not None:
        _draw_landmark(axes, fft_seconds)
    _frame_times(axes)
    _fold_below_cap(axes)
    figure.draw_without_rendering()  # settles the layout, which the labels' places in pixels depend on
    _label_points(axes, kept)
    return figure


def _draw_time(axes: Axes, row: Row, colour: str) -> None:
    spread: list[Any] = [row.get("p10_s"), row.get("p90_s")]
    if all(tables.is_number(time) and 0 < time < math.inf for time in spread):
        axes.plot(spread, [row["psnr_db"]] * 2, color=colour, linewidth=1.2, alpha=0.6)
    axes.plot(row["median_s"], row["psnr_db"], "o", color=colour, markersize=7, zorder=3)


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


def _label_points(axes: Axes, rows: Sequence[Row]) -> None:
    """Write each method at the nearest place where it meets no other label, line, point or edge, if there is one."""
    points = axes.transData.transform([(row["median_s"], row["psnr_db"]) for row in rows])
    taken = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in points]
    paths = [line.get_transform().transform_path(line.get_path()) for line in axes.get_lines()]
    for row, point in zip(rows, points, strict=True):
        where = (row["median_s"], row["psnr_db"])
        text = axes.annotate(tables.drawable(row["method"]), where, (0, 0), "data", "offset points", **CENTRED)
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


def _fold_below_cap(axes: Axes) -> None:
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
    axes.axhspan(knee, CAP_DB - pad / squeeze, color=PALE, alpha=0.35, linewidth=0, zorder=0)


def _calm(axes: Axes, x: str, y: str, title: str, pad: float = 6) -> None:
    axes.set_title(title, fontsize=10.5, loc="left", color=BLACK, pad=pad)
    axes.set(xlabel=x, ylabel=y)
    axes.tick_params(labelsize=9, color=GREY)
    axes.grid(color=PALE, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)


def _capped(rows: Iterable[Row], column: str) -> list[dict[str, Any]]:
    return [{**row, column: min(row[column], CAP_DB) if column.endswith("psnr_db") else row[column]} for row in rows]
