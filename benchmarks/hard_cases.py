"""Tables of the page on hard cases, from those of `lfref bench group=stability`, and its picture, from new trials."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import torch
from matplotlib.figure import Figure

from lfref.bench.stability import components as stability_components
from lfref.bench.stability.catalogue import HardCase
from lfref.bench.stability.trials import run_trials
from lfref.functional.psnr import inverse_psnr_of_mse
from lfref.report import stability_table, tables

ROOT = Path(__file__).resolve().parents[1]
RUN = ROOT / "runs" / "figures" / "stability"
SHOWN = ("1 - SSIM", "loss")
PRECISIONS = ("float32", "float16", "autocast bfloat16")
BENIGN = ("benign", "black prediction", "11 pixels wide", "batch of 1")
DECIBELS = (120, 110, 100, 50, 20 / math.log(10), 6, 3, 1, 0, -6)


def trials() -> Iterator[str]:
    """Number of trials that hold, ours beside the textbook forms, and those of ours that do not."""
    rows = tables.read_table(RUN / "stability.csv")
    yield "| component | ours hold | textbook form | it holds |"
    yield "|---|---|---|---|"
    for component, members in rows.groupby("component", sort=False):
        holds = members["outcome"].eq("holds").groupby(members["formulation"], sort=False)
        ours, *others = (f"{trials.sum()} of {len(trials)}" for _, trials in holds)
        _, *names = holds.groups
        for name, count in zip(names or [""], others or [""], strict=True):
            yield f"| {component} | {ours} | {name} | {count} |"
    yield ""
    yield "Of ours these do not hold:"
    yield ""
    lost = rows[(rows["formulation"] == stability_table.OURS) & (rows["outcome"] != "holds")]
    reasons = lost["note"].fillna(lost["case"] + " in " + lost["precision"])
    for (component, outcome), cases in reasons.groupby([lost["component"], lost["outcome"]], sort=False):
        yield f"- {component}: {outcome} ({', '.join(cases)})"


def departures() -> Iterator[str]:
    """1 / PSNR as the paper has it and as it is here, inside and outside of the range where both are one."""
    yield "| PSNR, dB | paper | here |"
    yield "|---|---|---|"
    for decibel in DECIBELS:
        ours = float(inverse_psnr_of_mse(torch.tensor(10 ** (-decibel / 10), dtype=torch.float64)))
        paper = f"{1 / decibel:.5f}" if decibel else "infinite"
        yield f"| {decibel:.4g} | {paper} | {ours:.5f} |".replace("-", tables.MINUS)
    ours = float(inverse_psnr_of_mse(torch.zeros((), dtype=torch.float64)))
    yield f"| infinite | 0, gradient not a number | {ours:.5f} |"


def picture() -> Figure:
    """Trials of 1 - SSIM and of the loss in three precisions, on the cases that take no seconds and are not benign."""
    components = [component for component in stability_components.image_components() if component.name in SHOWN]
    quick = [each._replace(cases=tuple(case for case in each.cases if _is_shown(case))) for each in components]
    return stability_table.heat_map(pd.DataFrame(row for row in run_trials(quick) if row["precision"] in PRECISIONS))


def _is_shown(case: HardCase) -> bool:
    is_finite = all(bool(part.isfinite().all()) for part in case.make(torch.float32))
    return is_finite and case.name not in BENIGN


PICTURES: dict[str, Callable[[], Figure]] = {"stability.png": picture}
TABLES: dict[str, Callable[[], Iterator[str]]] = {"trials": trials, "departures": departures}
