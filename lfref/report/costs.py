"""What operators cost: speed beside NumPy's 4-D FFT, memory beside what is allowed, and growth with its exponents."""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter, NullLocator

from lfref.report import drawing, tables, wording
from lfref.report.drawing import BLUE, ORANGE, RED, TEAL, calm, new_figure


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
    name = wording.drawable(points["method"].iloc[0], 40)
    label = f"{name}  {exponent:.2f}".replace("-", wording.MINUS)
    axes.plot(sizes, times, linestyle="", markersize=4.5, label=label, **look)


def _frame_sizes(axes: Axes, sizes: Sequence[int]) -> None:
    """Logarithmic axes whose ticks are the sizes themselves."""
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(sizes, [wording.cell_for_people("n", size) for size in sizes])
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
