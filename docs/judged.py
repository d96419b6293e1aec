"""What the experiments with networks share: scenes with their truth, networks by method and seed, tables that are kept.

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


def judges(names: Iterable[str], planes: FocalPlanes, with_sensor: bool = False) -> Iterator[EvaluationCase]:
    """What methods are judged on: scenes of sim30 as a perfect sensor records them, and as their own does if asked."""
    chosen = (sim30.SCENES[name] for name in track(list(names), description="judging"))
    scenes = chosen if with_sensor else (dataclasses.replace(scene, sensor=Sensor()) for scene in chosen)
    return evaluation.scene_cases(scenes, planes.slopes, torch.device("cpu"))


def loaded(folders: Mapping[str, Sequence[Path]]) -> list[NetworkRefocuser]:
    """Trained networks, named after their method and seed.

    Args:
        folders: Method -> a run folder for each seed.
    """
    found = []
    for method, runs in folders.items():
        for seed, run in enumerate(runs):
            found.append(load(run))
            found[-1].name = f"{method}{SEED}{seed}"
    return found


def kept(path: Path, sources: Iterable[Path], rows: Callable[[], Iterable[Mapping[str, Any]]]) -> pd.DataFrame:
    """A table that is made once, and again where what it is made of is newer; `method` and `seed` are columns.

    Args:
        path: The CSV file.
        sources: Run folders of the networks in it.
        rows: Makes its rows, each with a `method`.
    """
    made = path.stat().st_mtime if path.exists() else 0.0
    if any((run / "checkpoints" / "best.ckpt").stat().st_mtime > made for run in sources) or not made:
        table = pd.DataFrame(list(rows()))
        names = table["method"].str.partition(SEED)
        tables.write_table(path, table.assign(method=names[0], seed=pd.to_numeric(names[2]).fillna(0).astype(int)))
    return tables.read_table(path)


def spread(rows: pd.DataFrame, column: str, form: str = ".1f") -> str:
    """The mean over seeds of a method's means, and from which to which they go."""
    means = rows.groupby("seed")[column].mean()
    low, mean, high = (f"{value:{form}}" for value in (means.min(), means.mean(), means.max()))
    return mean if len(means) == 1 else f"{mean} ({low} to {high})"
