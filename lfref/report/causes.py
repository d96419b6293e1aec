"""Where the decibels are: a bar for what each cause costs, and marks for what each remedy wins back."""

from collections.abc import Collection

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lfref.report import drawing, tables, wording
from lfref.report.drawing import CYAN, GREY, PALE, calm, new_figure

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
    heading = wording.heading(place)
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
        style = drawing.look(index) | {"label": f"won by {wording.drawable(method, 40)}"}
        axes.plot(won, range(len(names)), linestyle="", markersize=5, zorder=3, **style)
    axes.axvline(0, color=GREY, linewidth=0.8, zorder=2)
    axes.set_facecolor("white")
    axes.grid(axis="y", color=PALE)
