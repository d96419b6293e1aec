"""Hard cases as heat maps: a row a case, a column a formulation and a precision, ours beside the usual ones.

A cell's colour says what became of the trial: right, how far off, no number, or a number where there should be none.
"""

import itertools
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from lfref.report import tables
from lfref.report.drawing import BLACK, CYAN, GREY, MAGENTA, ORANGE, PALE, RED, TEAL, new_figure
from lfref.report.page import Section
from lfref.report.tables import Row

COLUMNS = ("component", "case", "precision", "formulation", "times_allowed", "outcome", "holds")
OURS = "lfref"
OUTCOMES = {
    "holds": (TEAL, "within what is allowed"),
    "inexact": (ORANGE, "beyond: 1 time"),
    "not finite": (BLACK, "no finite number, or gradient"),
    "hidden": (MAGENTA, "finite where the input is not"),
    "refused": (CYAN, "refused, as it may be"),
    "error": (GREY, "fails with an error"),
    "missing": (PALE, "not there yet"),
}
"""Colour and meaning of what can become of a trial."""
WORST = 6
"""Decades beyond what is allowed from which all is one red."""
WIDEST = 40
"""Columns of cells in one picture."""
CELL, HEADER, NAMES = 0.17, 1.35, 2.4
"""Inches: the side of a cell, the room above the cells, and beside them."""


def heat_map(rows: Sequence[Row], title: str = "") -> Figure:
    """One panel a component, all with the same cases.

    Args:
        rows: `component, case, precision, formulation, times_allowed, outcome`.
        title: Above the panels.

    Raises:
        InputError: One of these columns is missing.
    """
    tables.need(rows, *COLUMNS)
    panels, cases = tables.grouped(rows, "component"), tables.names(rows, "case")
    widths = [len(_columns(members)) for members in panels.values()]
    figure = new_figure(NAMES + CELL * sum(widths) + 0.3 * len(widths), HEADER + CELL * len(cases) + 0.6)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left", color=BLACK)
    all_axes = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
    for axes, ((component,), members) in zip(all_axes, panels.items(), strict=True):
        _draw_panel(axes, component, members, cases)
    for axes in all_axes[1:]:
        axes.set_yticklabels([])
    figure.legend(
        handles=_legend({row["outcome"] for row in rows}),
        loc="outside lower left",
        ncols=3,
        frameon=False,
        fontsize=8,
    )
    return figure


def heat_maps(rows: Sequence[Row]) -> dict[str, Figure]:
    """All components, those with the same cases side by side, as many as a picture has room for.

    Args:
        rows: As for `heat_map`.

    Returns:
        Figures by caption.
    """
    tables.need(rows, *COLUMNS)
    components = tables.grouped((row for row in rows if row["outcome"] != "missing"), "component")
    panels = {name: _Panel(members) for (name,), members in components.items()}
    made = {}
    for names in _pictures(panels):
        caption = " to ".join(dict.fromkeys((names[0], names[-1])))
        made[caption] = heat_map([row for name in names for row in panels[name].rows])
    return made


def goals(folder: Path) -> Section:
    """What was to hold, and what was measured.

    Args:
        folder: Run folder of `lfref bench group=stability`.
    """
    rows = tables.read_table(folder / "goals.csv")
    kept = sum(row["holds"] == "yes" for row in rows)
    text = (
        f"{kept} of {len(rows)} goals hold. The usual formulation is measured in the same way where there is one: "
        "torchmetrics for SSIM, the paper's formula as it stands for the loss."
    )
    return Section("What has to hold", text, tables={"Goals": rows})


def hard_cases(folder: Path) -> Section:
    """The heat maps, and how many trials ended how.

    Args:
        folder: Run folder of `lfref bench group=stability`.
    """
    rows = tables.read_table(folder / "stability.csv")
    text = (
        "Every component on every hard case in every precision, against an oracle in float64. Beyond what is allowed "
        "a cell turns from orange to red; black is NaN or infinity in the value or in the gradient."
    )
    return Section(
        "Hard cases", text, dict(heat_maps(rows)), {"Trials": counts(rows), "Where ours fails": failures(rows)}
    )


def counts(rows: Sequence[Row]) -> list[Row]:
    """How the trials of each component and formulation ended.

    Args:
        rows: As for `heat_map`.

    Returns:
        Rows `component, formulation, trials` and a column for each outcome.
    """
    tables.need(rows, *COLUMNS)
    return [
        {"component": component, "formulation": formulation, "trials": len(members)}
        | {outcome: sum(row["outcome"] == outcome for row in members) for outcome in OUTCOMES}
        for (component, formulation), members in tables.grouped(rows, "component", "formulation").items()
    ]


def failures(rows: Sequence[Row]) -> list[Row]:
    """Our own trials that do not hold; one line that says so if all do.

    Args:
        rows: As for `heat_map`.
    """
    kept = ("component", "case", "precision", "outcome", "error", "times_allowed", "note")
    ours = [row for row in rows if row["formulation"] == OURS and row["holds"] != "yes"]
    return [{column: row.get(column) for column in kept} for row in ours] or [{"component": "none"}]


class _Panel(NamedTuple):
    """One component."""

    rows: list[Row]

    @property
    def width(self) -> int:
        """Columns of cells."""
        return len(_columns(self.rows))

    def has_cases_of(self, other: "_Panel") -> bool:
        """Whether one of the two has all the cases of the other."""
        mine, theirs = (set(tables.names(panel.rows, "case")) for panel in (self, other))
        return mine <= theirs or theirs <= mine


def _pictures(panels: Mapping[str, _Panel]) -> Iterator[list[str]]:
    """The names of the panels of each picture: the same cases and formulations, at most `WIDEST` columns."""
    waiting = list(panels)
    while waiting:
        first = panels[waiting[0]]
        alike = [name for name in waiting if panels[name].has_cases_of(first) and panels[name].width == first.width]
        taken = alike[: max(1, WIDEST // first.width)]
        waiting = [name for name in waiting if name not in taken]
        yield taken


def _columns(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """All precisions of one formulation, then those of the next."""
    formulations, columns = tables.names(rows, "formulation"), tables.grouped(rows, "formulation", "precision")
    return sorted(columns, key=lambda column: formulations.index(column[0]))


def _draw_panel(axes: Axes, component: str, rows: Sequence[Row], cases: Sequence[str]) -> None:
    columns = _columns(rows)
    cells = np.ones((len(cases), len(columns), 3))
    for row in rows:
        cells[cases.index(row["case"]), columns.index((row["formulation"], row["precision"]))] = _colour(row)
    axes.imshow(cells, aspect="equal", interpolation="nearest")
    # A column is nearly three letters wide.
    axes.set_title(textwrap.fill(component, round(2.8 * len(columns)) + 2), fontsize=8.5, loc="left", color=BLACK)
    axes.set_yticks(range(len(cases)), cases, fontsize=8)
    axes.set_xticks(range(len(columns)), [precision for _, precision in columns], rotation=90, fontsize=7)
    axes.tick_params(top=True, labeltop=True, bottom=False, labelbottom=False, length=0, color=GREY)
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(cases) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.7)
    axes.tick_params(which="minor", length=0)
    axes.spines[:].set_visible(False)
    _name_formulations(axes, columns)


def _name_formulations(axes: Axes, columns: Sequence[tuple[str, str]]) -> None:
    """Each name below its columns, a line between one and the next."""
    for formulation, members in itertools.groupby(enumerate(columns), key=lambda pair: pair[1][0]):
        places = [place for place, _ in members]
        where = (places[0] - 0.4, -0.01)
        axes.text(*where, formulation, fontsize=7.5, va="top", transform=axes.get_xaxis_transform(), color=BLACK)
        if places[0]:
            axes.axvline(places[0] - 0.5, color=BLACK, linewidth=1.5)


def _colour(row: Row) -> tuple[float, float, float]:
    if row["outcome"] != "inexact":
        return to_rgb(OUTCOMES[row["outcome"]][0])
    return _shade(math.log10(max(row["times_allowed"], 1.0)) if tables.is_number(row["times_allowed"]) else WORST)


def _shade(decades: float) -> tuple[float, float, float]:
    """From pale orange to red."""
    share = min(decades, WORST) / WORST
    pale, strong = np.array(to_rgb("#FFDDAA")), np.array(to_rgb(RED))
    red, green, blue = pale + share * (strong - pale)
    return red, green, blue


def _legend(outcomes: set[str]) -> list[Patch]:
    """What these outcomes look like, one entry a line; those beyond what is allowed in three shades."""
    entries = []
    for outcome in (name for name in OUTCOMES if name in outcomes):
        colour, text = OUTCOMES[outcome]
        shades = [(_shade(decades), f"{10**decades:,} times what is allowed") for decades in (1, 3, WORST)]
        entries += shades if outcome == "inexact" else [(to_rgb(colour), text)]
    return [Patch(color=colour, label=text) for colour, text in entries]
