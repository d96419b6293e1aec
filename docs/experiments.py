"""Shared by `paper.py` and `ablations.py`: scenes with their truth, networks by method and seed, tables made once.

Letters: `N` planes.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from rich.progress import track

from lfref.bench import evaluation
from lfref.bench.evaluation import EvaluationCase
from lfref.geometry import FocalPlanes
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.report import tables
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor

MARGIN = 24
"""Pixels of the border that the interior lacks, as in `lfref bench`."""
SEED = ", seed "
"""In the name of a network, between its method and its seed."""


def cases(names: Iterable[str], planes: FocalPlanes, with_sensor: bool = False) -> Iterator[EvaluationCase]:
    """Scenes of sim30 with their truth, as a perfect sensor records them; `with_sensor`: as their own does too."""
    scenes = (sim30.SCENES[name] for name in track(list(names), description="evaluating"))
    if not with_sensor:
        scenes = (dataclasses.replace(scene, sensor=Sensor()) for scene in scenes)
    return evaluation.scene_cases(scenes, planes.slopes, torch.device("cpu"))


def load_networks(folders: Mapping[str, Sequence[Path]]) -> list[NetworkRefocuser]:
    """Trained networks, named after their method and seed.

    Args:
        folders: Method -> a run folder for each seed.
    """
    networks = []
    for method, runs in folders.items():
        for seed, run in enumerate(runs):
            network = load(run)
            network.name = f"{method}{SEED}{seed}"
            networks.append(network)
    return networks


def cached_table(path: Path, runs: Iterable[Path], rows: Callable[[], Iterable[Mapping[str, Any]]]) -> pd.DataFrame:
    """A table with columns `method` and `seed`; it is made where it is missing, or older than one of the networks.

    Args:
        path: The CSV file.
        runs: Run folders of the networks in it.
        rows: Makes its rows, each with a `method`.
    """
    written = path.stat().st_mtime if path.exists() else 0.0
    if not written or any((run / "checkpoints" / "best.ckpt").stat().st_mtime > written for run in runs):
        table = pd.DataFrame(list(rows()))
        names = table["method"].str.partition(SEED)
        tables.write_table(path, table.assign(method=names[0], seed=pd.to_numeric(names[2]).fillna(0).astype(int)))
    return tables.read_table(path)


def mean_and_range(rows: pd.DataFrame, column: str, form: str = ".1f") -> str:
    """Mean of a column, and the least and the largest mean of a seed, as text."""
    means = rows.groupby("seed")[column].mean()
    low, mean, high = (f"{value:{form}}" for value in (means.min(), means.mean(), means.max()))
    return mean if len(means) == 1 else f"{mean} ({low} to {high})"
