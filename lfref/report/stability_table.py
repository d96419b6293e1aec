"""Hard cases as heat maps: a row per case, a column per formulation and precision; the colour is the outcome."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from lfref.report import tables
from lfref.report.drawing import BLACK, CYAN, GREY, MAGENTA, ORANGE, RED, TEAL, new_figure
from lfref.report.page import Section

COLUMNS = ("component", "case", "precision", "formulation", "times_allowed", "outcome", "holds")
OURS = "lfref"
OUTCOMES = {
    "holds": (TEAL, "within the tolerance"),
    "inexact": (ORANGE, "beyond the tolerance"),
    "not finite": (BLACK, "value or gradient not finite"),
    "hidden": (MAGENTA, "finite where the input is not"),
    "refused": (CYAN, "refused, as allowed"),
    "error": (GREY, "fails with an error"),
}
"""Outcome of a trial -> colour and meaning."""
WORST = 6
"""Decades beyond the tolerance at which the red is full."""
WIDEST = 40
"""Most columns of cells in one picture."""
CELL, HEADER, NAMES = 0.17, 1.35, 2.4
"""Side of a cell, and room above the cells and beside them, in inches."""


def heat_map(trials: pd.DataFrame) -> Figure:
    """One panel per component, all with the same cases.

    Args:
        trials: Columns `component, case, precision, formulation, times_allowed, outcome, holds`.

    Raises:
        InputError: One of these columns is missing.
    """
    tables.require(trials, *COLUMNS)
    panels, cases = dict(list(trials.groupby("component", sort=False))), trials["case"].unique().tolist()
    widths = [len(_columns(panel)) for panel in panels.values()]
    figure = new_figure(NAMES + CELL * sum(widths) + 0.3 * len(widths), HEADER + CELL * len(cases) + 0.6)
    all_axes = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
    for axes, (component, panel) in zip(all_axes, panels.items(), strict=True):
        _draw_panel(axes, component, panel, cases)
    for axes in all_axes[1:]:
        axes.set_yticklabels([])
    handles = _legend(set(trials["outcome"]))
    figure.legend(handles=handles, loc="outside lower left", ncols=3, frameon=False, fontsize=8)
    return figure


def heat_maps(trials: pd.DataFrame) -> dict[str, Figure]:
    """Caption -> heat map of components with the same cases, at most `WIDEST` columns each."""
    tables.require(trials, *COLUMNS)
    panels = dict(list(trials.groupby("component", sort=False)))
    return {
        " to ".join(dict.fromkeys((names[0], names[-1]))): heat_map(pd.concat([panels[name] for name in names]))
        for names in _groups(panels)
    }


def hard_cases(folder: Path) -> Section:
    """The heat maps, and the number of trials by outcome, of `lfref bench group=stability`."""
    trials = tables.read_table(folder / "stability.csv")
    text = (
        "Every component on every hard case in every precision, against a reference formula in float64. Beyond the "
        "tolerance a cell turns from orange to red; black is NaN or infinity in the value or in the gradient."
    )
    listed = {"Trials": counts(trials), "Our trials that fail": failures(trials)}
    ours = trials[trials["formulation"] == OURS]
    answer = f"{(ours['holds'] == 'yes').sum()} of {len(ours)} trials of lfref hold."
    return Section("Hard cases", text, dict(heat_maps(trials)), listed, answer=answer)


def counts(trials: pd.DataFrame) -> pd.DataFrame:
    """Number of trials of each component and formulation: `component, formulation, trials`, a column per outcome."""
    tables.require(trials, *COLUMNS)
    outcomes = trials.groupby(["component", "formulation"], sort=False)["outcome"]
    counted = outcomes.value_counts().unstack(fill_value=0).reindex(outcomes.size().index)
    counted = counted.reindex(columns=[*OUTCOMES], fill_value=0)
    counted.insert(0, "trials", outcomes.size())
    return counted.reset_index()


def failures(trials: pd.DataFrame) -> pd.DataFrame:
    """Our own trials that do not hold; a row "none" if all do."""
    columns = ["component", "case", "precision", "outcome", "error", "times_allowed", "note"]
    ours = trials[(trials["formulation"] == OURS) & (trials["holds"] != "yes")]
    return pd.DataFrame({"component": ["none"]}) if ours.empty else ours.reindex(columns=columns)


def _groups(panels: Mapping[str, pd.DataFrame]) -> Iterator[list[str]]:
    """Names of the panels of each picture, with the same cases and widths, at most `WIDEST` columns."""
    cases = {name: set(panel["case"]) for name, panel in panels.items()}
    widths = {name: len(_columns(panel)) for name, panel in panels.items()}
    rest = list(panels)
    while rest:
        first = rest[0]
        alike = [
            name
            for name in rest
            if widths[name] == widths[first] and (cases[name] <= cases[first] or cases[first] <= cases[name])
        ]
        group = alike[: max(1, WIDEST // widths[first])]
        rest = [name for name in rest if name not in group]
        yield group


def _columns(panel: pd.DataFrame) -> pd.DataFrame:
    """`formulation, precision` of every column of cells: all precisions of one formulation, then of the next."""
    pairs = panel[["formulation", "precision"]].drop_duplicates()
    order = {name: place for place, name in enumerate(pairs["formulation"].unique())}
    return pairs.sort_values("formulation", key=lambda names: names.map(order), kind="stable", ignore_index=True)


def _draw_panel(axes: Axes, component: str, panel: pd.DataFrame, cases: Sequence[str]) -> None:
    columns = _columns(panel)
    places = pd.MultiIndex.from_frame(columns)
    cells = np.ones((len(cases), len(columns), 3))
    for row in panel.itertuples():
        cells[cases.index(row.case), places.get_loc((row.formulation, row.precision))] = _colour(row)
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


def _colour(row: Any) -> tuple[float, float, float]:
    if row.outcome != "inexact":
        return to_rgb(OUTCOMES[row.outcome][0])
    # An error without a number counts as the worst.
    return _shade(WORST if math.isnan(row.times_allowed) else math.log10(max(row.times_allowed, 1.0)))


def _shade(decades: float) -> tuple[float, float, float]:
    """Colour of an error beyond the tolerance, from pale orange to red."""
    share = min(decades, WORST) / WORST
    pale, strong = np.array(to_rgb("#FFDDAA")), np.array(to_rgb(RED))
    red, green, blue = pale + share * (strong - pale)
    return red, green, blue


def _legend(outcomes: set[str]) -> list[Patch]:
    """An entry per outcome; three shades for those beyond the tolerance."""
    entries = []
    for outcome in (name for name in OUTCOMES if name in outcomes):
        colour, text = OUTCOMES[outcome]
        shades = [(_shade(decades), f"{10**decades:,} times the tolerance") for decades in (1, 3, WORST)]
        entries += shades if outcome == "inexact" else [(to_rgb(colour), text)]
    return [Patch(color=colour, label=text) for colour, text in entries]
