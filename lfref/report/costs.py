"""What operators cost: speed beside NumPy's 4-D FFT, memory beside what is allowed, and growth with its exponents."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter, NullLocator

from lfref.report import tables, wording
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, MAGENTA, ORANGE, RED, TEAL, calm, new_figure
from lfref.report.tables import Row

COLOURS = (BLUE, RED, TEAL, ORANGE, MAGENTA, CYAN, BLACK, GREY)
MARKERS = ("o", "^", "s", "D", "v", "P", "X", "<", ">", "p", "h", "*")


def operator_costs(rows: Sequence[Row]) -> Figure:
    """Speed and peak memory of every method, one line each, the fastest at the top.

    Args:
        rows: `method`, `input`, `median_s`, `p10_s`, `p90_s`, `ratio_to_numpy_fft`, `memory_ratio`.

    Raises:
        InputError: One of these columns is missing, or no method has a time.
    """
    tables.need(rows, "method", "input", "memory_ratio")
    timed = tables.some(rows, "median_s", "p10_s", "p90_s", "ratio_to_numpy_fft")
    kept = sorted(timed, key=lambda row: row["ratio_to_numpy_fft"])
    figure = new_figure(9, 1.2 + 0.32 * len(kept))
    speed, memory = figure.subplots(1, 2, sharey=True, width_ratios=(1.4, 1))
    speed.set_yticks(range(len(kept)), [_name(row) for row in kept])
    _draw_speeds(speed, kept)
    _draw_memory(memory, kept)
    return figure


def growth(rows: Sequence[Row], exponents: Sequence[Row]) -> Figure:
    """Time against size, one panel an axis, with the fitted powers.

    Args:
        rows: `method`, `axis`, `n`, `min_s`.
        exponents: `method`, `axis`, `exponent`, fitted to these rows.

    Raises:
        InputError: One of these columns is missing, or has no number.
    """
    tables.need(rows, "method", "axis")
    kept, fitted = tables.some(rows, "n", "min_s"), tables.grouped(exponents, "method", "axis")
    axes_names, methods = tables.names(kept, "axis"), tables.names(kept, "method")
    figure = new_figure(4 * len(axes_names), 4 + 0.2 * len(methods))
    panels = figure.subplots(1, len(axes_names), sharey=True, squeeze=False)[0]
    for axes, axis in zip(panels, axes_names, strict=True):
        for index, method in enumerate(methods):
            points = [(row["n"], row["min_s"]) for row in kept if (row["method"], row["axis"]) == (method, axis)]
            look = {"color": COLOURS[index % len(COLOURS)], "marker": MARKERS[index % len(MARKERS)]}
            _draw_power(axes, points, fitted[method, axis][0]["exponent"], method, look)
        _frame_sizes(axes, [row["n"] for row in kept if row["axis"] == axis])
        calm(axes, f"Number of {axis}", "", f"Growth with {axis}")
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.16),
            frameon=False,
            fontsize=8,
            title="fitted exponent",
            title_fontsize=8,
        )
    panels[0].set_ylabel("Time, fastest run")
    return figure


def _name(row: Row) -> str:
    kind = "" if row["input"] == "float32" else f" ({row['input']})"
    return f"{row['method']}{kind}".replace("$", r"\$")


def _draw_speeds(axes: Axes, rows: Sequence[Row]) -> None:
    axes.set_xscale("log")
    axes.axvline(1, color=RED, linestyle="--", linewidth=1.2)
    for place, row in enumerate(rows):
        fft = row["ratio_to_numpy_fft"] * row["median_s"]
        axes.plot([fft / row["p90_s"], fft / row["p10_s"]], [place, place], color=BLUE, linewidth=1.2, alpha=0.6)
        axes.plot(row["ratio_to_numpy_fft"], place, "o", color=BLUE, markersize=6)
    _frame(axes, [row["ratio_to_numpy_fft"] for row in rows])
    calm(axes, "Times faster than NumPy's 4-D FFT (log scale)", "", "Speed: to the right is better")


def _draw_memory(axes: Axes, rows: Sequence[Row]) -> None:
    axes.axvline(1, color=RED, linestyle="--", linewidth=1.2)
    for place, row in enumerate(rows):
        if tables.is_number(row["memory_ratio"]):
            axes.barh(place, row["memory_ratio"], height=0.5, color=TEAL if row["memory_ratio"] <= 1 else ORANGE)
    axes.set_axisbelow(True)
    calm(axes, "Peak / (twice the field + the stack)", "", "Memory: to the left is better")


def _draw_power(axes: Axes, points: Sequence[tuple[float, float]], exponent: float, name: str, look: Any) -> None:
    """The points of one method, and its power through their middle."""
    sizes, times = np.array(sorted(points), float).T
    middle = np.exp(np.log(sizes).mean()), np.exp(np.log(times).mean())
    axes.plot(sizes, middle[1] * (sizes / middle[0]) ** exponent, color=look["color"], linewidth=1.2, alpha=0.6)
    label = f"{wording.drawable(name, 40)}  {exponent:.2f}".replace("-", wording.MINUS)
    axes.plot(sizes, times, linestyle="", markersize=4.5, label=label, **look)


def _frame_sizes(axes: Axes, sizes: Sequence[int]) -> None:
    """Logarithmic axes whose ticks are the sizes themselves."""
    axes.set(xscale="log", yscale="log")
    shown = sorted(set(sizes))
    axes.set_xticks(shown, [wording.cell_for_people("n", size) for size in shown])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.yaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _frame(axes: Axes, ratios: Sequence[float]) -> None:
    low, high = math.log10(min(*ratios, 1)), math.log10(max(*ratios, 1))
    margin = max(0.1 * (high - low), 0.1)
    axes.set_xlim(10 ** (low - margin), 10 ** (high + margin))
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high - low < 2 else (1, 3)))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
