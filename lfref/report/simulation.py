"""What simulating costs: planned beside forced; and how far refocused views are from the truth, plane by plane."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from lfref.report import tables, wording
from lfref.report.drawing import BLUE, GREY, ORANGE, RED, TEAL, calm, new_figure
from lfref.report.tables import Row

COLOURS = {"views": BLUE, "truth": ORANGE}
LINES = (BLUE, TEAL, RED, GREY)


def costs_and_distances(costs: Sequence[Row], alphas: Sequence[Row]) -> Figure:
    """How many times cheaper planning makes each class of scenes, and PSNR against the truth by alpha.

    Args:
        costs: `scene`, `asked`, `forced_over_planned`.
        alphas: `method`, `alpha`, `mean_db`, `worst_db`.

    Raises:
        InputError: One of these columns is missing.
    """
    tables.need(costs, "scene", "asked", "forced_over_planned")
    tables.need(alphas, "method", "alpha", "mean_db", "worst_db")
    figure = new_figure(10, 1.5 + 0.3 * max(8, len(tables.names(costs, "scene"))))
    left, right = figure.subplots(1, 2)
    _draw_costs(left, costs)
    _draw_distances(right, alphas)
    return figure


def _draw_costs(axes: Axes, rows: Sequence[Row]) -> None:
    scenes = tables.names(rows, "scene")[::-1]
    axes.set_yticks(range(len(scenes)), scenes)
    for asked, colour in COLOURS.items():
        kept = [row for row in rows if row["asked"] == asked]
        places = [scenes.index(row["scene"]) for row in kept]
        axes.plot([row["forced_over_planned"] for row in kept], places, "o", color=colour, label=asked)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.axvline(1, color=RED, linestyle="--", linewidth=1)
    calm(axes, "Forced / planned time (log scale)", "", "What planning saves")
    axes.legend(frameon=False, fontsize=8)


def _draw_distances(axes: Axes, rows: Sequence[Row]) -> None:
    for method, colour in zip(tables.names(rows, "method"), LINES, strict=False):
        kept = [row for row in rows if row["method"] == method]
        alphas = [row["alpha"] for row in kept]
        axes.plot(alphas, [row["mean_db"] for row in kept], "o-", color=colour, markersize=3, label=f"{method}, mean")
        axes.plot(
            alphas, [row["worst_db"] for row in kept], "o:", color=colour, markersize=3, label=f"{method}, worst scene"
        )
    calm(axes, wording.heading("alpha"), "PSNR, dB", "Refocused views against the truth")
    # Below: lines are all over the place.
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.12))
