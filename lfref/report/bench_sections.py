"""What simulating costs: planned beside forced; and how far refocused views are from the truth, plane by plane."""

import math
from collections.abc import Collection, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter, NullLocator

from lfref.report import drawing, tables
from lfref.report.drawing import BLUE, CYAN, GREY, ORANGE, PALE, RED, TEAL, calm, new_figure

# PART causes
# Where the decibels are: a bar for what each cause costs, and marks for what each remedy wins back.

COLUMNS = ["cause", "method", "is_base", "alpha", "slope", "cost_db", "won_db"]


def causes(by_plane: pd.DataFrame, panels_at: Collection[float] | None = None) -> Figure:
    """A panel for the mean over planes, and one for each plane.

    Args:
        by_plane: `cause`, `method`, `is_base`, `alpha`, `slope`, `cost_db`, `won_db`; the cost stands with the base,
            the others are remedies.
        panels_at: Alphas, or slopes, of the planes that get a panel; None: all. The mean is over all in any case.

    Raises:
        InputError: One of these columns is missing.
    """
    tables.need(by_plane, *COLUMNS)
    names = by_plane["cause"].unique().tolist()[::-1]
    remedies = by_plane.loc[~by_plane["is_base"].astype(bool), "method"].unique().tolist()
    place = "slope" if by_plane["alpha"].isna().any() else "alpha"
    means = by_plane.groupby(["cause", "method", "is_base"], sort=False)[["cost_db", "won_db"]].mean().reset_index()
    heading = tables.heading(place)
    shown = by_plane if panels_at is None else by_plane[by_plane[place].isin(panels_at)]
    panels = {"mean over planes": means} | {f"{heading} {at:g}": each for at, each in shown.groupby(place)}
    figure = new_figure(2 + 2.6 * len(panels), 1.6 + 0.32 * len(names))
    drawn = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (title, rows) in zip(drawn, panels.items(), strict=True):
        _draw(axes, rows, names, remedies)
        calm(axes, "dB", "", title)
    drawn[0].set_yticks(range(len(names)), names)
    handles = {line.get_label(): line for axes in drawn for line in [*axes.containers, *axes.get_lines()]}
    named = {label: handle for label, handle in handles.items() if not label.startswith("_")}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def _draw(axes: Axes, rows: pd.DataFrame, names: list[str], remedies: list[str]) -> None:
    is_base = rows["is_base"].astype(bool)
    costs = rows[is_base].groupby("cause")["cost_db"].first().reindex(names)
    axes.barh(range(len(names)), costs, height=0.62, color=CYAN, alpha=0.45, label="costs", zorder=1)
    for index, method in enumerate(remedies):
        won = rows[~is_base & (rows["method"] == method)].groupby("cause")["won_db"].first().reindex(names)
        style = drawing.look(index) | {"label": f"won by {tables.drawable(method, 40)}"}
        axes.plot(won, range(len(names)), linestyle="", markersize=5, zorder=3, **style)
    axes.axvline(0, color=GREY, linewidth=0.8, zorder=2)
    axes.set_facecolor("white")
    axes.grid(axis="y", color=PALE)


# PART costs
# What operators cost: speed beside NumPy's 4-D FFT, memory beside what is allowed, and growth with its exponents.


def operator_costs(operators: pd.DataFrame) -> Figure:
    """Speed and peak memory of every method, one line each, the fastest at the top.

    Args:
        operators: `method`, `input`, `median_s`, `p10_s`, `p90_s`, `ratio_to_numpy_fft`, `memory_ratio`.

    Raises:
        InputError: One of these columns is missing, or no method has a time.
    """
    tables.need(operators, "method", "input", "memory_ratio")
    timed = tables.some(operators, "median_s", "p10_s", "p90_s", "ratio_to_numpy_fft")
    kept = timed.sort_values("ratio_to_numpy_fft", kind="stable").reset_index(drop=True)
    figure = new_figure(9, 1.2 + 0.32 * len(kept))
    speed, memory = figure.subplots(1, 2, sharey=True, width_ratios=(1.4, 1))
    kinds = np.where(kept["input"] == "float32", "", " (" + kept["input"] + ")")
    speed.set_yticks(kept.index, (kept["method"] + kinds).str.replace("$", r"\$"))
    _draw_speeds(speed, kept)
    _draw_memory(memory, tables.complete(kept, "memory_ratio")["memory_ratio"])
    return figure


def growth(times: pd.DataFrame, exponents: pd.DataFrame) -> Figure:
    """Time against size, one panel an axis, with the fitted powers.

    Args:
        times: `method`, `axis`, `n`, `min_s`.
        exponents: `method`, `axis`, `exponent`, fitted to these times.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    tables.need(times, "method", "axis")
    tables.need(exponents, "method", "axis", "exponent")
    kept = tables.some(times, "n", "min_s").merge(exponents, on=["method", "axis"])
    axes_names, methods = kept["axis"].unique(), kept["method"].unique().tolist()
    figure = new_figure(4 * len(axes_names), 4 + 0.2 * len(methods))
    panels = figure.subplots(1, len(axes_names), sharey=True, squeeze=False)[0]
    for axes, axis in zip(panels, axes_names, strict=True):
        shown = kept[kept["axis"] == axis]
        for index, method in enumerate(methods):
            _draw_power(axes, shown[shown["method"] == method], index)
        _frame_sizes(axes, sorted(shown["n"].unique()))
        calm(axes, f"Number of {axis}", "", f"Growth with {axis}")
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16)}
        axes.legend(frameon=False, fontsize=8, title="fitted exponent", title_fontsize=8, **below)
    panels[0].set_ylabel("Time, fastest run")
    return figure


def _draw_speeds(axes: Axes, operators: pd.DataFrame) -> None:
    axes.set_xscale("log")
    axes.axvline(1, color=RED, linestyle="--", linewidth=1.2)
    ratios = operators["ratio_to_numpy_fft"]
    fft = ratios * operators["median_s"]
    axes.hlines(operators.index, fft / operators["p90_s"], fft / operators["p10_s"], color=BLUE, lw=1.2, alpha=0.6)
    axes.plot(ratios, operators.index, "o", color=BLUE, markersize=6)
    _frame(axes, ratios)
    calm(axes, "Times faster than NumPy's 4-D FFT (log scale)", "", "Speed: to the right is better")


def _draw_memory(axes: Axes, ratios: pd.Series) -> None:
    axes.axvline(1, color=RED, linestyle="--", linewidth=1.2)
    axes.barh(ratios.index, ratios, height=0.5, color=[TEAL if ratio <= 1 else ORANGE for ratio in ratios])
    axes.set_axisbelow(True)
    calm(axes, "Peak / (twice the field + the stack)", "", "Memory: to the left is better")


def _draw_power(axes: Axes, points: pd.DataFrame, index: int) -> None:
    """The points of one method, and its power through their middle."""
    if points.empty:
        return
    points, look = points.sort_values("n"), drawing.look(index)
    sizes, times, exponent = points["n"], points["min_s"], points["exponent"].iloc[0]
    middle = np.exp(np.log(sizes).mean()), np.exp(np.log(times).mean())
    axes.plot(sizes, middle[1] * (sizes / middle[0]) ** exponent, color=look["color"], linewidth=1.2, alpha=0.6)
    name = tables.drawable(points["method"].iloc[0], 40)
    label = f"{name}  {exponent:.2f}".replace("-", tables.MINUS)
    axes.plot(sizes, times, linestyle="", markersize=4.5, label=label, **look)


def _frame_sizes(axes: Axes, sizes: Sequence[int]) -> None:
    """Logarithmic axes whose ticks are the sizes themselves."""
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(sizes, [tables.cell_for_people("n", size) for size in sizes])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.yaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _frame(axes: Axes, ratios: pd.Series) -> None:
    low, high = math.log10(min(ratios.min(), 1)), math.log10(max(ratios.max(), 1))
    margin = max(0.1 * (high - low), 0.1)
    axes.set_xlim(10 ** (low - margin), 10 ** (high + margin))
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high - low < 2 else (1, 3)))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


# PART engines
# What engines make of networks: how much faster they are, and how far their pictures are from float32's.

COLOURS = {"fp32": BLUE, "bf16": TEAL, "int8": ORANGE}
SHOWN_DB = 20.0
"""Decibels of agreement where bars begin."""


def engines(rows: pd.DataFrame) -> Figure:
    """A line of panels for each network: speed, and what is lost.

    Args:
        rows: `network`, `engine`, `precision`, `ratio_to_eager`, `loss_db`, `agreement_db`.

    Raises:
        InputError: One of these columns is missing, or nothing was timed.
    """
    tables.need(rows, "network", "engine", "precision", "loss_db", "agreement_db")
    timed = tables.some(rows, "ratio_to_eager")
    subjects = list(timed.groupby("network", sort=False))
    figure = new_figure(8, 0.8 + sum(0.8 + 0.22 * len(group) for _, group in subjects))
    heights = [3 + len(group) for _, group in subjects]
    panels = figure.subplots(len(subjects), 2, squeeze=False, width_ratios=(1.5, 1), height_ratios=heights)
    for (speed, loss), (subject, group) in zip(panels, subjects, strict=True):
        ranked = group.sort_values("ratio_to_eager", kind="stable").reset_index(drop=True)
        _draw_engine_speeds(speed, ranked, tables.drawable(subject, 60))
        _draw_losses(loss, ranked)
    handles = [Patch(color=colour, label=precision) for precision, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def _draw_engine_speeds(axes: Axes, rows: pd.DataFrame, subject: str) -> None:
    ratios = rows["ratio_to_eager"]
    axes.barh(rows.index, ratios, height=0.62, color=rows["precision"].map(COLOURS))
    axes.axvline(1, color=GREY, linewidth=0.8)
    axes.set_yticks(rows.index, rows["engine"] + " " + rows["precision"])
    for place, ratio in enumerate(ratios):
        axes.annotate(f"{ratio:.1f}", (ratio, place), (3, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_xlim(0, 1.12 * ratios.max())
    axes.set_axisbelow(True)
    calm(axes, "Times faster than eager fp32", "", subject)


def _draw_losses(axes: Axes, rows: pd.DataFrame) -> None:
    """Decibels lost against truth; of a network without training, how near its pictures are to eager float32's."""
    has_truth = bool(rows["loss_db"].notna().any())
    values = rows["loss_db"] if has_truth else rows["agreement_db"].clip(lower=SHOWN_DB)
    left = 0.0 if has_truth else SHOWN_DB
    axes.barh(rows.index, values - left, left=left, height=0.62, color=rows["precision"].map(COLOURS))
    axes.set_yticks(rows.index, [""] * len(rows))
    text = values.map(_told if has_truth else lambda value: tables.cell_for_people("psnr_db", value))
    for place, (value, shown) in enumerate(zip(np.maximum(values, left), text, strict=True)):
        axes.annotate(shown, (value, place), (3, 0), textcoords="offset points", va="center", fontsize=8)
    axes.margins(x=0.2)
    axes.set_axisbelow(True)
    title = "What is lost: to the left is better" if has_truth else "Agreement with eager fp32"
    calm(axes, "dB" if has_truth else "PSNR, dB", "", title)


def _told(value: float) -> str:
    """Two digits, nothing without a sign."""
    return f"{round(value, 2) + 0.0:.2f}"


COLOURS_OF_SIMULATION = {"views": BLUE, "truth": ORANGE}


def costs_and_distances(costs: pd.DataFrame, planes: pd.DataFrame) -> Figure:
    """How many times cheaper planning makes each class of scenes, and PSNR against the truth by plane.

    Args:
        costs: `scene`, `output`, `forced_over_planned`.
        planes: `method`, `alpha`, `slope`, `mean_db`, `worst_db`; places are slopes where an alpha is missing.

    Raises:
        InputError: One of these columns is missing.
    """
    tables.need(costs, "scene", "output", "forced_over_planned")
    tables.need(planes, "method", "alpha", "slope", "mean_db", "worst_db")
    figure = new_figure(10, 1.5 + 0.3 * max(8, costs["scene"].nunique()))
    left, right = figure.subplots(1, 2)
    _draw_costs(left, costs)
    _draw_distances(right, planes)
    return figure


def _draw_costs(axes: Axes, costs: pd.DataFrame) -> None:
    scenes = costs["scene"].unique().tolist()[::-1]
    axes.set_yticks(range(len(scenes)), scenes)
    for output, colour in COLOURS_OF_SIMULATION.items():
        kept = costs[costs["output"] == output]
        axes.plot(kept["forced_over_planned"], kept["scene"].map(scenes.index), "o", color=colour, label=output)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.axvline(1, color=RED, linestyle="--", linewidth=1)
    calm(axes, "Forced / planned time (log scale)", "", "What planning saves")
    axes.legend(frameon=False, fontsize=8)


def _draw_distances(axes: Axes, planes: pd.DataFrame) -> None:
    place = "slope" if planes["alpha"].isna().any() else "alpha"
    for index, (method, kept) in enumerate(planes.groupby("method", sort=False)):
        style = {"color": drawing.look(index)["color"], "markersize": 3}
        axes.plot(kept[place], kept["mean_db"], "o-", label=f"{method}, mean", **style)
        axes.plot(kept[place], kept["worst_db"], "o:", label=f"{method}, worst scene", **style)
    calm(axes, tables.heading(place), "PSNR, dB", "Refocused views against the truth")
    # Below: lines are all over the place.
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.12))
