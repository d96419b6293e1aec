"""Shared by `paper.py` and `ablations.py`: planes, methods and networks, and how they are evaluated on sim30.

Letters: `N` planes, `C H W` channel, pixel row and column.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd
import torch
from markers import ROOT
from rich.progress import track
from torch import Tensor
from torch.nn import functional as F

from lfref.bench import accuracy, evaluation, timing
from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH, EvaluationCase
from lfref.data.field_sources import SimulatedSource
from lfref.geometry import FocalPlanes, planes_at_alphas
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.mean_of_views import mean_of_views
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocus.shift.shift_and_sum import shift_and_sum, shift_and_sum_through_cells
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

ALPHAS = tuple(step / 8 for step in range(1, 17))
PLANES = planes_at_alphas(ALPHAS)
CLASSICAL = {
    name: OperatorRefocuser(name, operator)
    for name, operator in {
        RIVAL: mean_of_views,
        "shift_and_sum": shift_and_sum,
        "fourier_slice": functools.partial(fourier_slice, kernel="kaiser_bessel", width=4, padding=2),
        "fourier_slice_linear": functools.partial(fourier_slice, kernel="linear", padding=1),
        "shift_and_sum_through_cells": shift_and_sum_through_cells,
        "occlusion_aware": occlusion_aware,
    }.items()
}
"""The settings of `conf/method`."""
WEIGHTS = ROOT / "runs" / "weights"
"""Folder of the runs of `make weights`."""
NETWORKS = {
    "shift_and_sum": "RefNet on shift_and_sum",
    "fourier_slice": "RefNet on fourier_slice",
    "rendered": "RefNet on the truth",
}
"""Label source, a file of `conf/label` -> the method of its networks."""
RECIPES = {
    "shift_and_sum": ["experiment=refnet", "label=shift_and_sum"],
    "fourier_slice": ["experiment=refnet_truth", "label=fourier_slice"],
    "rendered": ["experiment=refnet_truth"],
}
"""Label source -> overrides of `lfref train`."""
SEED = ", seed "
"""Text in the name of a network between its method and its seed."""
LAPLACIAN = torch.tensor([[0.0, 1.0, 0.0], [1.0, -4.0, 1.0], [0.0, 1.0, 0.0]])[None, None]
KEYS = ["method", "reference"]
SIZE = (375, 540)
"""Height and width of the views that times are measured with, in pixels, as in the paper."""
TIME = "time, ms (in FFTs)"
"""Heading of what `times` returns."""
ROUNDS = 3  # of the measurement of times, of which the first is a warm-up


def cases(names: Iterable[str], planes: FocalPlanes) -> Iterator[EvaluationCase]:
    """Scenes of sim30 as a perfect sensor records them, with their truth."""
    scenes = (sim30.SCENES[name] for name in track(list(names), description="evaluating"))
    perfect = (dataclasses.replace(scene, sensor=Sensor()) for scene in scenes)
    return evaluation.scene_cases(perfect, planes.slopes, torch.device("cpu"))


@torch.no_grad()
def plane_rows(cases: Iterable[EvaluationCase], methods: Sequence[Refocuser], labels: Sequence[str]) -> pd.DataFrame:
    """Every method by each label and by the truth, over the whole frame as in the paper, a row for each plane.

    No method gets the aperture of a scene, since networks have no input for it.

    Args:
        cases: Scenes with their truth at the paper's planes.
        methods: Methods of different names.
        labels: Names of the methods that made labels.

    Returns:
        Columns of `accuracy.plane_rows`, `delta_e`, and `sharpness` as a share of the reference's.
    """
    rows = []
    for case in cases:
        stacks = {method.name: method(case.light, PLANES.slopes) for method in methods}
        references = {label: CLASSICAL[label](case.light, PLANES.slopes) for label in labels} | {TRUTH: case.reference}
        for (method, stack), (reference, label) in itertools.product(stacks.items(), references.items()):
            compared = accuracy.plane_rows(case.light.name, {method: stack}, {reference: label}, PLANES)
            delta_e = accuracy.colour_difference(stack, label).mean((-2, -1))
            more = zip(compared, delta_e.tolist(), (sharpness(stack) / sharpness(label)).tolist(), strict=True)
            rows += [row | {"delta_e": colour, "sharpness": ratio} for row, colour, ratio in more]
    return pd.DataFrame(rows)


def runs(n_seeds: int, folder: Path = WEIGHTS) -> dict[str, list[Path]]:
    """Label source -> the run folder of each seed; the first has no seed in its name."""
    seeds = ["", *(f"_{seed}" for seed in range(1, n_seeds))]
    return {label: [folder / f"{label}{seed}" for seed in seeds] for label in NETWORKS}


def networks(paths: Mapping[str, Sequence[Path]]) -> list[Refocuser]:
    """Trained networks, named after their method and seed, from what `runs` returns."""
    loaded = []
    for label, of_label in paths.items():
        for seed, path in enumerate(of_label):
            network = load(path)
            network.name = f"{NETWORKS[label]}{SEED}{seed}"
            loaded.append(network)
    return loaded


def sharpness(stack: Tensor) -> Tensor:
    """Mean size of the Laplacian of every plane, [N, C, H, W] -> [N]."""
    return F.conv2d(stack.flatten(0, 1)[:, None], LAPLACIAN).abs().mean((1, 2, 3)).unflatten(0, stack.shape[:2]).mean(1)


def scores(rows: pd.DataFrame) -> pd.DataFrame:
    """Means of `plane_rows` by `KEYS`, also without slope 0 (`nonzero_`), and the share of refocusing explained."""
    means, nonzero, widest = (
        part.groupby(KEYS, sort=False)[["psnr_db", "ssim", "colour_error", "delta_e"]].mean()
        for part in (rows, rows[rows["slope"] != 0], rows[rows["alpha"] == ALPHAS[0]])
    )
    means = means.join(nonzero.add_prefix("nonzero_")).assign(widest_db=widest["psnr_db"])
    return means.join(accuracy.explained(rows, KEYS))


@torch.no_grad()
def times(methods: Mapping[str, Callable[[Tensor], object]]) -> dict[str, str]:
    """Milliseconds of each method for one light field, and in brackets NumPy's 4-D FFTs of the same views, as text."""
    views = timed_views()
    watches = {
        name: functools.partial(timing.seconds, functools.partial(method, views), views.device)
        for name, method in methods.items()
    }
    watches[timing.FFT] = functools.partial(timing.numpy_fft_time, views)
    spent = timing.in_turns(watches, range(ROUNDS), warmup=1)
    medians = {name: pd.Series(seconds).median() for name, seconds in spent.items()}
    return {name: f"{1e3 * medians[name]:,.0f} ({medians[name] / medians[timing.FFT]:.2f})" for name in methods}


def timed_views() -> Tensor:
    """Views of a simulated light field to measure times with."""
    return SimulatedSource(1, 7, RandomScenes(Camera(size=SIZE))).field(0).views


def head(*cells: str) -> Iterator[str]:
    """The first row of a table, and the line below it."""
    yield row(*cells)
    yield row(*("---" for _ in cells))


def row(*cells: str) -> str:
    """A row of a table."""
    return f"| {' | '.join(cells)} |"
