"""Pictures of `paper.md`, drawn where `make paper` has left its tables; otherwise the old ones stay.

Letters: `s` slope in pixels per view step.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import experiments
import pandas as pd
import sheets
import torch
from markers import ROOT
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from paper_methods import BEST, CLASSICAL, NETWORKS, PLANES
from torch import Tensor

from lfref.bench.evaluation import IDEAL
from lfref.report import drawing, tables
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, MAGENTA, ORANGE, RED, TEAL

RUNS = ROOT / "runs" / "paper"
COLOURS = {
    "shift_and_sum": BLUE,
    "fourier_slice": RED,
    "fourier_slice_linear": GREY,
    "shift_and_sum_through_cells": ORANGE,
    BEST: BLACK,
    **dict(zip(NETWORKS, (CYAN, MAGENTA, TEAL), strict=True)),
}
SCENE, SHOWN = "twigs", (0.125, 2.0)
INNER = (..., slice(32, -32), slice(experiments.MARGIN, -experiments.MARGIN))
FINEST = 3e-3  # smaller differences are shown as none
DIFFERENCE: dict[str, Any] = {"cmap": "magma", "norm": LogNorm(FINEST, 0.3)}


def scatter(runs: Path) -> Figure:
    """The paper's figure, a point a scene: networks by their own labels, and all methods by truth."""
    rows = tables.read_table(runs / "labels.csv")
    points = rows.groupby(["method", "reference", "light_field"], sort=False)[["psnr_db", "ssim"]].mean().reset_index()
    own = [(method, label) for method, label in NETWORKS.items() if label in CLASSICAL]
    by_truth = [(method, "truth") for method in COLOURS]
    figure = drawing.new_figure(sheets.WIDTH, 3.6)
    panels = zip(figure.subplots(1, 2), (own, by_truth), ("as the paper: by their own labels", "by truth"), strict=True)
    for axes, series, title in panels:
        for method, reference in series:
            of_it = points[(points["method"] == method) & (points["reference"] == reference)]
            look = {"color": COLOURS[method], "marker": "^" if method in NETWORKS else "o"}
            axes.plot(of_it["ssim"], of_it["psnr_db"], linestyle="", markersize=3.5, alpha=0.75, label=method, **look)
        sheets.label(axes, tables.heading("mssim"), tables.heading("mpsnr_db"), title)
    _legend(figure)
    return figure


def by_alpha(runs: Path) -> Figure:
    """Accuracy and brightness of every method over alpha, by truth; a band goes from seed to seed."""
    rows = tables.read_table(runs / "truth.csv")
    rows = rows[rows["class"] == IDEAL]
    figure = drawing.new_figure(sheets.WIDTH, 3.6)
    columns = {"psnr_db": "PSNR, dB", "brightness": "brightness over that of the truth"}
    for axes, (column, title) in zip(figure.subplots(1, 2), columns.items(), strict=True):
        for method, colour in COLOURS.items():
            _draw_band(axes, rows[rows["method"] == method], column, colour)
        sheets.label(axes, tables.heading("alpha"), "", title)
    _legend(figure)
    return figure


def comparison(runs: Path) -> Figure:
    """A scene by truth, by the paper's two methods and by networks, and what each of them lacks."""
    case = next(experiments.cases([SCENE], PLANES))
    networks = experiments.load_networks({method: [_first(runs, label)] for method, label in NETWORKS.items()})
    rows = {name: CLASSICAL[name] for name in ("shift_and_sum", "fourier_slice")}
    rows |= dict(zip(NETWORKS, networks, strict=True))
    methods = (CLASSICAL[BEST], *rows.values())
    best, *stacks = (case.stack(method, PLANES.slopes)[INNER] for method in methods)
    cells = []
    for alpha in SHOWN:
        index = (PLANES.alphas or ()).index(alpha)
        truth = case.reference[INNER][index]
        titles = [name.replace("RefNet on ", "RefNet on\n") for name in rows]
        cells += [(f"truth,\nalpha {alpha:g}", truth), *zip(titles, (stack[index] for stack in stacks), strict=True)]
        cells += [_difference(f"{BEST}\n", best[index], truth)]
        cells += [_difference("difference\n", stack[index], truth) for stack in stacks]
    return sheets.sheet(cells, 6, bar="absolute difference", **DIFFERENCE)


def _first(runs: Path, label: str) -> Path:
    return runs / "networks" / label / "seed_0"


def _difference(title: str, picture: Tensor, truth: Tensor) -> tuple[str, Tensor]:
    return title + sheets.decibels(picture, truth), torch.clamp((picture - truth).abs().mean(0), min=FINEST)


def _draw_band(axes: Axes, rows: pd.DataFrame, column: str, colour: str) -> None:
    """The mean over scenes and seeds along alpha, and how far single seeds go."""
    of_seeds = rows.groupby(["alpha", "seed"])[column].mean().unstack()
    style = "--" if rows["method"].iloc[0] in NETWORKS else "-"
    axes.plot(of_seeds.index, of_seeds.mean(axis=1), style, color=colour, linewidth=1.4, label=rows["method"].iloc[0])
    axes.fill_between(of_seeds.index, of_seeds.min(axis=1), of_seeds.max(axis=1), color=colour, alpha=0.2, linewidth=0)


def _legend(figure: Figure) -> None:
    handles = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    figure.legend(handles=[*handles.values()], loc="outside lower center", ncols=3, frameon=False, fontsize=7)


DRAWN: dict[str, tuple[Callable[[Path], Figure], str]] = {
    "paper_scatter.png": (scatter, "MPSNR against MSSIM, a point a scene: by their own labels, and by truth"),
    "paper_by_alpha.png": (by_alpha, "PSNR and brightness over alpha, by truth"),
    "paper_comparison.jpg": (
        comparison,
        "A scene at two planes: truth, methods, networks, and what they lack",
    ),
}
"""Name -> function that draws it from a folder of runs, and its caption."""
PICTURES: dict[str, Callable[[], Figure]] = {
    name: functools.partial(draw, RUNS) for name, (draw, _) in DRAWN.items() if (RUNS / "truth.csv").exists()
}
"""Name -> function, for `pictures.py`."""
