"""Pictures of `paper.md`, from the table of `paper.py` and its networks."""

from collections.abc import Callable, Sequence
from typing import Any

import experiments
import pandas as pd
import sheets
import torch
from experiments import ALPHAS, CLASSICAL, NETWORKS, PLANES, SEED
from markers import ROOT
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from torch import Tensor

from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH
from lfref.refocuser.refocuser import Refocuser
from lfref.report import drawing, tables
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, MAGENTA, RED, TEAL

TABLE = ROOT / "runs" / "paper" / "planes.csv"
COLOURS = {
    RIVAL: GREY,
    "shift_and_sum": BLUE,
    "fourier_slice": RED,
    "occlusion_aware": BLACK,
    **dict(zip(NETWORKS.values(), (CYAN, MAGENTA, TEAL), strict=True)),
}
SCENE, SHOWN = "twigs", (0.125, 2.0)
INNER = (..., slice(32, -32), slice(24, -24))
FINEST = 3e-3  # smaller differences are shown as none
DIFFERENCE: dict[str, Any] = {"cmap": "magma", "norm": LogNorm(FINEST, 0.3)}


def scatter(rows: pd.DataFrame) -> Figure:
    """The paper's figure, a point a scene: networks by their own labels, and all methods by the truth."""
    points = rows.assign(method=rows["method"].str.partition(SEED)[0])
    points = points.groupby(["method", "reference", "light_field"])[["psnr_db", "ssim"]].mean()
    own = [(method, label) for label, method in NETWORKS.items() if label in CLASSICAL]
    panels = {
        "as the paper: by their own labels": [(RIVAL, "shift_and_sum"), *own],
        "by the truth": [(method, TRUTH) for method in COLOURS],
    }
    figure = drawing.new_figure(sheets.WIDTH, 3.6)
    for axes, (title, pairs) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        for pair in pairs:
            look = {"color": COLOURS[pair[0]], "marker": "^" if pair[0] in NETWORKS.values() else "o"}
            of_pair = points.loc[pair]
            axes.plot(
                of_pair["ssim"], of_pair["psnr_db"], linestyle="", markersize=3.5, alpha=0.75, label=pair[0], **look
            )
        sheets.label(axes, tables.heading("mssim"), tables.heading("mpsnr_db"), title)
    handles = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    figure.legend(handles=[*handles.values()], loc="outside lower center", ncols=3, frameon=False, fontsize=7)
    return figure


def comparison(networks: Sequence[Refocuser]) -> Figure:
    """A scene at two planes: the truth, two methods, a network of each label source, and how far they are from it."""
    case = next(experiments.cases([SCENE], PLANES))
    names = (RIVAL, "shift_and_sum")
    methods = [*(CLASSICAL[name] for name in names), *networks]
    titles = [*names, *(name.replace("RefNet on ", "RefNet on\n") for name in NETWORKS.values())]
    stacks = [method(case.light, PLANES.slopes)[INNER] for method in methods]
    cells = []
    for alpha in SHOWN:
        index = ALPHAS.index(alpha)
        truth = case.reference[INNER][index]
        cells += [(f"truth,\nalpha {alpha:g}", truth)]
        cells += [(title, stack[index]) for title, stack in zip(titles, stacks, strict=True)]
        cells += [("no\ndifference", torch.full(truth.shape[-2:], FINEST))]
        cells += [_difference(stack[index], truth) for stack in stacks]
    return sheets.sheet(cells, 1 + len(stacks), bar="absolute difference", **DIFFERENCE)


def _difference(picture: Tensor, truth: Tensor) -> tuple[str, Tensor]:
    return "difference\n" + sheets.decibels(picture, truth), torch.clamp((picture - truth).abs().mean(0), min=FINEST)


CAPTIONS = {
    "paper_scatter.png": "MPSNR against MSSIM, a point a scene: by their own labels, and by the truth",
    "paper_comparison.jpg": "A scene at two planes: truth, methods, networks, and how far they are from the truth",
}
PICTURES: dict[str, Callable[[], Figure]] = (
    {
        "paper_scatter.png": lambda: scatter(tables.read_table(TABLE)),
        "paper_comparison.jpg": lambda: comparison(experiments.networks(experiments.runs(1))),
    }
    if TABLE.exists()
    else {}
)
"""Name -> function, for `pictures.py`; where `make paper` has left no table, the pictures stay as they are."""
