"""Pictures of refocusing beside the truth: plots of the tables of `lfref bench`, and methods beside the lens's picture.

The plots are drawn where `make figures` has left the tables; otherwise the old ones stay.
Letters: `s` slope in pixels per view step.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import scenes
import sheets
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from torch import Tensor

import lfref
from lfref.bench.evaluation import IDEAL
from lfref.bench.timing import FFT
from lfref.report import pictures, plots, tables
from lfref.simulator import sim30

RUNS = Path(__file__).resolve().parents[1] / "runs" / "figures"
BENCH, CAUSES = RUNS / "bench" / "bench.csv", RUNS / "causes" / "causes_by_plane.csv"
SCENE = "twigs"
WIDE, FOCUS = -7.0, 0.5  # slopes of the widest blur among the paper's planes, and next to a surface of the scene
INNER = (..., slice(24, -24), slice(24, -24))  # every view covers it at all the paper's planes
DIFFERENCE: dict[str, Any] = {"cmap": "magma", "norm": LogNorm(1e-4, 0.1)}


def accuracy_time() -> Figure:
    """The front of the scenes without a sensor's effects."""
    rows = tables.read_table(BENCH)
    return plots.front(rows[(rows["class"] == IDEAL) | (rows["method"] == FFT)])


def causes() -> Figure:
    """Cost of each cause of error, and gains of the remedies."""
    rows = tables.read_table(CAUSES)
    return plots.error_causes(rows, panels_at=(0.125, 2.0))


def cells() -> Figure:
    """A scene far out of focus: the sum over points, the integral over cells, and the lens."""
    views, truth = _views_and_truth(WIDE)
    points, filled = (lfref.shift_and_sum(views, [WIDE], "cubic", fill=fill)[0] for fill in (0.0, 1.0))
    shown = [("truth", truth[INNER]), ("49 points", points[INNER]), ("49 cells, fill=1", filled[INNER])]
    errors = [_difference(picture, truth) for picture in (points, filled)]
    view = ("one view", views[3, 3][INNER])
    return sheets.sheet([*shown, view, *errors], bar="absolute difference", **DIFFERENCE)


def near_focus() -> Figure:
    """A scene focused on one of its surfaces, by four methods: what each does wrong."""
    views, truth = _views_and_truth(FOCUS)
    pictures = {
        "exact_fourier": lfref.exact_fourier(views, [FOCUS]),
        "exact_fourier, fill=1": lfref.exact_fourier(views, [FOCUS], fill=1.0),
        "refocus_by_layers": lfref.refocus_by_layers(views, [FOCUS]),
        "occlusion_aware": lfref.occlusion_aware(views, [FOCUS]),
    }
    errors = [_difference(stack[0], truth, name + "\n") for name, stack in pictures.items()]
    return sheets.sheet(errors, 4, bar="absolute difference", **DIFFERENCE)


def disparity() -> Figure:
    """Disparity map of the still life, its confidence, and the true disparity."""
    views, truth = scenes.still_life()
    estimate = lfref.disparity_map(views)
    cells = [
        ("confidence, white: 1", estimate.confidence[None]),
        ("disparity_map", estimate.disparity),
        ("truth", truth),
    ]
    style = {"vmin": scenes.FAR, "vmax": scenes.NEAR, "cmap": pictures.MAP}
    return sheets.sheet(cells, bar="disparity, px per view step", **style)


PLOTS: dict[str, tuple[Path, Callable[[], Figure]]] = {
    "accuracy_time.png": (BENCH, accuracy_time),
    "causes.png": (CAUSES, causes),
}
PICTURES: dict[str, Callable[[], Figure]] = {
    "cells.jpg": cells,
    "near_focus.jpg": near_focus,
    "disparity_map.jpg": disparity,
    **{name: draw for name, (table, draw) in PLOTS.items() if table.exists()},
}


def _views_and_truth(slope: float) -> tuple[Tensor, Tensor]:
    """Views and truth of the scene at a slope."""
    result = lfref.simulate(sim30.SCENES[SCENE], slopes=(slope,))
    return result.views, result.truth[0]


def _difference(picture: Tensor, truth: Tensor, title: str = "difference, ") -> tuple[str, Tensor]:
    size = (picture - truth)[INNER].abs().mean(0).clamp(min=DIFFERENCE["norm"].vmin)
    return title + sheets.decibels(picture[INNER], truth[INNER]), size
