"""Hard cases as heat maps: a row per case, a column per formulation and precision; the colour is the outcome."""

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from lfref.report import tables
from lfref.report.drawing import BLACK, GREY, MAGENTA, ORANGE, TEAL, new_figure
from lfref.report.page import Section

OURS = "lfref"
OUTCOMES = {
    "holds": (TEAL, "within the tolerance"),
    "inexact": (ORANGE, "beyond the tolerance"),
    "not finite": (BLACK, "value or gradient not finite"),
    "hidden": (MAGENTA, "finite where the input is not"),
    "error": (GREY, "fails with an error"),
}
"""Outcome of a trial -> colour and meaning."""
MOST_PANELS = 4
"""Most components in one picture."""
CELL, HEADER, SIDE = 0.17, 1.35, 2.4
"""Side of a cell, and room above the cells and beside them, in inches."""


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


def hard_cases(folder: Path) -> Section:
    """The heat maps, and the number of trials by outcome, of `lfref bench suite=stability`."""
    columns = ("component", "case", "precision", "formulation", "times_allowed", "outcome", "note")
    trials = tables.read_table(folder / "stability.csv", *columns)
    text = (
        "Every component on every hard case in every precision, against a reference formula in float64. Orange is "
        "beyond the tolerance, black is NaN or infinity in the value or in the gradient."
    )
    is_ours = trials["formulation"] == OURS
    held, failed = is_ours & (trials["outcome"] == "holds"), trials[is_ours & (trials["outcome"] != "holds")]
    names = [trials["component"], trials["formulation"]]
    listed = {"Trials by outcome": pd.crosstab(names, trials["outcome"]).reset_index()}
    if len(failed):
        listed["Our trials that fail"] = failed[["component", "case", "precision", "outcome", "times_allowed", "note"]]
    answer = f"{held.sum()} of {is_ours.sum()} trials of lfref hold."
    return Section("Hard cases", text, heat_maps(trials), listed, answer=answer)


def heat_maps(trials: pd.DataFrame) -> dict[str, Figure]:
    """Caption -> heat map of up to `MOST_PANELS` components that follow each other and have the same cases."""
    cases = {str(name): set(panel["case"]) for name, panel in trials.groupby("component", sort=False)}
    pictures: list[list[str]] = []
    for name in cases:
        if not pictures or len(pictures[-1]) == MOST_PANELS or not cases[name] <= cases[pictures[-1][0]]:
            pictures.append([])
        pictures[-1].append(name)
    return {", ".join(names): heat_map(trials[trials["component"].isin(names)]) for names in pictures}


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
