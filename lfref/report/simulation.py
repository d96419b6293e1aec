"""What simulating costs: planned beside forced; and how far refocused views are from the truth, plane by plane."""

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from lfref.report import drawing, tables, wording
from lfref.report.drawing import BLUE, ORANGE, RED, calm, new_figure

COLOURS = {"views": BLUE, "truth": ORANGE}


def costs_and_distances(costs: pd.DataFrame, planes: pd.DataFrame) -> Figure:
    """How many times cheaper planning makes each class of scenes, and PSNR against the truth by plane.

    Args:
        costs: `scene`, `asked`, `forced_over_planned`.
        planes: `method`, `alpha`, `slope`, `mean_db`, `worst_db`; places are slopes where an alpha is missing.

    Raises:
        InputError: One of these columns is missing.
    """
    tables.need(costs, "scene", "asked", "forced_over_planned")
    tables.need(planes, "method", "alpha", "slope", "mean_db", "worst_db")
    figure = new_figure(10, 1.5 + 0.3 * max(8, costs["scene"].nunique()))
    left, right = figure.subplots(1, 2)
    _draw_costs(left, costs)
    _draw_distances(right, planes)
    return figure


def _draw_costs(axes: Axes, costs: pd.DataFrame) -> None:
    scenes = costs["scene"].unique().tolist()[::-1]
    axes.set_yticks(range(len(scenes)), scenes)
    for asked, colour in COLOURS.items():
        kept = costs[costs["asked"] == asked]
        axes.plot(kept["forced_over_planned"], kept["scene"].map(scenes.index), "o", color=colour, label=asked)
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
    calm(axes, wording.heading(place), "PSNR, dB", "Refocused views against the truth")
    # Below: lines are all over the place.
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.12))
