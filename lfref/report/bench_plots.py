"""Plots of `lfref bench`, one function per table: error causes, costs of operators, growth, the simulator.

A missing column, or a table without numbers, raises an `InputError` that names it.
"""

import math
from collections.abc import Collection

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter, NullLocator

from lfref.report import drawing, tables
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, PALE, RED, new_figure, style_axes


def error_causes(by_plane: pd.DataFrame, panels_at: Collection[float] | None = None) -> Figure:
    """Bars for the cost of each cause, marks for what each remedy wins back; panels for the mean and for each plane.

    Args:
        by_plane: Columns `cause`, `method`, `is_base`, `alpha`, `slope`, `cost_db`, `won_db`; costs are those of base
            methods, and the other methods are remedies.
        panels_at: Alphas, or slopes, of the planes that get a panel; None: all. The mean is always over all planes.
    """
    tables.require(by_plane, "cause", "method", "is_base", "alpha", "slope", "cost_db", "won_db")
    causes = by_plane["cause"].unique().tolist()[::-1]
    by_plane = by_plane.assign(is_base=by_plane["is_base"].astype(str) == "True")  # text when read from a file
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
    handles = {line.get_label(): line for axes in all_axes for line in [*axes.containers, *axes.get_lines()]}
    named = {label: handle for label, handle in handles.items() if not label.startswith("_")}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def operator_costs(operators: pd.DataFrame) -> Figure:
    """Time of every method, one line each, the fastest at the top.

    Args:
        operators: Columns `method`, `median_s`, `p10_s`, `p90_s`, `numpy_ffts`.
    """
    tables.require(operators, "method")
    timed = tables.require_numbers(operators, "median_s", "p10_s", "p90_s", "numpy_ffts")
    rows = timed.sort_values("numpy_ffts", ascending=False, kind="stable").reset_index(drop=True)
    figure = new_figure(7, 1.2 + 0.32 * len(rows))
    axes = figure.subplots()
    axes.set_yticks(rows.index, rows["method"].str.replace("$", r"\$"))
    units = rows["numpy_ffts"]
    fft_s = rows["median_s"] / units
    axes.set_xscale("log")
    axes.axvline(1, color=RED, linestyle="--", linewidth=1.2)
    axes.hlines(rows.index, rows["p10_s"] / fft_s, rows["p90_s"] / fft_s, color=BLUE, lw=1.2, alpha=0.6)
    axes.plot(units, rows.index, "o", color=BLUE, markersize=6)
    low, high = math.log10(min(units.min(), 1)), math.log10(max(units.max(), 1))
    margin = max(0.1 * (high - low), 0.1)
    axes.set_xlim(10 ** (low - margin), 10 ** (high + margin))
    _label_log_axis(axes, (1, 2, 5) if high - low < 2 else (1, 3))
    style_axes(axes, "Time, in NumPy's 4-D FFTs (log scale)", "", "Time: to the left is better")
    return figure


def _label_log_axis(axes: Axes, subs: tuple[int, ...]) -> None:
    """Label a logarithmic x axis with plain numbers at these multiples of each decade."""
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def growth(times: pd.DataFrame, exponents: pd.DataFrame) -> Figure:
    """Time against size, a panel per method and a line per axis, with the fitted powers.

    Args:
        times: Columns `method`, `axis`, `n`, `min_s`.
        exponents: Columns `method`, `axis`, `exponent`, fitted to these times.
    """
    tables.require(times, "method", "axis")
    tables.require(exponents, "method", "axis", "exponent")
    rows = tables.require_numbers(times, "n", "min_s").merge(exponents, on=["method", "axis"])
    axis_names, methods = rows["axis"].unique().tolist(), rows["method"].unique().tolist()
    n_columns = min(4, len(methods))
    n_rows = math.ceil(len(methods) / n_columns)
    figure = new_figure(9, 0.6 + 1.9 * n_rows)
    grid = figure.subplots(n_rows, n_columns, squeeze=False, sharex=True, sharey=True)
    for axes in grid.flat[len(methods) :]:
        axes.set_visible(False)
    for axes, method in zip(grid.flat, methods, strict=False):
        powers = []
        for index, axis in enumerate(axis_names):
            points = rows[(rows["method"] == method) & (rows["axis"] == axis)].sort_values("n")
            if points.empty:
                continue
            style, exponent = drawing.series_style(index), points["exponent"].iloc[0]
            # The fitted power goes through the middle of the points, in logarithms.
            middle_n, middle_s = np.exp(np.log(points["n"]).mean()), np.exp(np.log(points["min_s"]).mean())
            fit = middle_s * (points["n"] / middle_n) ** exponent
            sizes = points["n"] / points["n"].max()
            axes.plot(sizes, fit, color=style["color"], linewidth=1.2, alpha=0.6)
            axes.plot(sizes, points["min_s"], linestyle="", markersize=4, label=axis, **style)
            powers.append(f"{axis} {exponent:.2f}".replace("-", tables.MINUS))
        axes.set(xscale="log", yscale="log")
        style_axes(axes, "", "", "")
        axes.set_title(f"{tables.plot_text(method, 40)}\n{', '.join(powers)}", fontsize=7.5, loc="left", color=BLACK)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{share:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_locator(LogLocator())
        axes.yaxis.set_major_formatter(EngFormatter(unit="s"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    figure.supxlabel("Share of the largest number (log scale); above each panel the fitted exponents", fontsize=9)
    figure.supylabel("Time, fastest run", fontsize=9)
    handles = {line.get_label(): line for axes in grid.flat for line in axes.get_lines() if line.get_marker() != "None"}
    figure.legend(handles=[*handles.values()], loc="outside upper left", ncols=3, frameon=False, fontsize=9)
    return figure
