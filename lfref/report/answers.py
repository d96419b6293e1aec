"""What a comparison of methods answers, in one sentence and in crops: how much better is ours than the best other?

"Ours" is the best network, and before all else it must be better than no refocusing, the mean of the views. Without a
network, or without a classical method, ours is the best of all, beside the next. Rows that a method judges of its own
pictures are left out. Only the truth, the picture of a lens, says which method is better; against any other reference,
one is only above another.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from torch import Tensor
from torch.nn import functional as F

from lfref.bench import accuracy
from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH
from lfref.encoding import NONE
from lfref.io import images
from lfref.report import pictures, tables
from lfref.report.tables import TRUTHS

SERIES = ["method", "reference"]
SAME_DB = 0.05
"""Difference in dB below which the sentence calls two methods equal: it has one decimal."""
CROPS = "crops"
SIDE = 72
"""Side of the part in pixels; the whole interior where that is smaller."""
MOST_AMPLIFIED = 64
"""Largest factor of a difference: beyond it, the steps of 8 bits would be seen."""


class Answer(NamedTuple):
    """A comparison of our method with another, over scenes or light fields."""

    kind: str
    """Class of the scenes; empty for an evaluation, which has no classes."""
    reference: str
    ours: str
    other: str | None
    """The method that ours is compared with; None: there is no other."""
    worst: str
    sentence: str


def of_evaluation(summary: pd.DataFrame, planes: pd.DataFrame) -> Answer | None:
    """The answer for the rendered label, which is the truth, else for the first one; None without methods."""
    rows = summary.rename(columns={"light_field": "scene", "mpsnr_db": "psnr_db"}).assign(**{"class": ""})
    means = rows.groupby([*SERIES, "class", "is_network"], sort=False)["psnr_db"].mean().reset_index()
    return of_bench(means.join(accuracy.explained(planes, SERIES), on=SERIES), rows)


def of_bench(bench: pd.DataFrame, scenes: pd.DataFrame) -> Answer | None:
    """The answer of the first class that the truth judges, else of the first class; None without methods."""
    rows = tables.judged_by_others(bench.dropna(subset=["class", "psnr_db"]))
    rows = rows[rows["method"] != RIVAL]
    if rows.empty:
        return None
    by_truth = rows[rows["reference"].isin(TRUTHS)]
    kind, reference = (rows if by_truth.empty else by_truth)[["class", "reference"]].iloc[0]
    rows = rows[(rows["class"] == kind) & (rows["reference"] == reference)].sort_values("psnr_db", ascending=False)
    # The best network and the best classical method; without one of them, the best two of all.
    networks, classical = rows[rows["is_network"]], rows[~rows["is_network"]]
    best = pd.concat([networks[:1], classical[:1]]) if len(networks) and len(classical) else rows
    ours, other = best.iloc[0], best.iloc[1] if len(best) > 1 else None
    of_ours = scenes[(scenes["class"] == kind) & (scenes["reference"] == reference) & (scenes["method"] == ours.method)]
    scores = of_ours.groupby("scene", sort=False)["psnr_db"].mean()
    where = f"{len(scores)} {f'scenes ({kind})' if reference == TRUTH and kind else 'light fields'}"
    sentence = f"On {where if len(scores) > 1 else scores.index[0]}"
    if reference not in TRUTHS:
        sentence += f", against {reference} (not the truth)"
    sentence += f", {ours.method} {_against_mean(ours)}{_compared(ours, other, reference)}"
    if len(scores) > 1:
        sentence += f", worst on {scores.idxmin()} ({scores.min():.1f} dB)"
    if "numpy_ffts" in rows:
        against = "" if other is None else f" against {other.numpy_ffts:.2g}"
        sentence += f", at {ours.numpy_ffts:.2g} units of time{against}"
    name = None if other is None else str(other.method)
    return Answer(str(kind), str(reference), str(ours.method), name, str(scores.idxmin()), f"{sentence}.")


def _against_mean(ours: pd.Series) -> str:
    explained, wide = ours.get("explained"), ours.get("explained_wide")
    if not ours.is_network or pd.isna(explained):
        return ""
    if explained < 0:
        times = f"its squared error is {1 - explained:.2g} times that of {RIVAL}"
        return f"is worse than no refocusing at all ({times}, explained {explained:.2g}) and "
    blurred = "" if pd.isna(wide) else f" (wide blur {100 * wide:.3g} %)"
    return f"explains {100 * explained:.3g} % of refocusing{blurred} and "


def _compared(ours: pd.Series, other: pd.Series | None, reference: str) -> str:
    if other is None:
        return f"has {ours.psnr_db:.1f} dB"
    is_truth, gain = reference in TRUTHS, ours.psnr_db - other.psnr_db
    rank = "best classical" if ours.is_network > other.is_network else "next"
    above, below, level = ("better than", "worse than", "as good as") if is_truth else ("above", "below", "level with")
    relation = level if abs(gain) < SAME_DB else f"{abs(gain):.1f} dB {above if gain > 0 else below}"
    return f"is {relation} the {rank} method, {other.method}"


def write_crops(
    folder: Path, view: Tensor, ours: Tensor, other: Tensor | None, reference: Tensor, margin: int = 0
) -> None:
    """Write the same part of five pictures [C, H, W] as a screen gets them, the fifth being the difference of ours.

    The part is where our picture is farthest from the reference; a border of `margin` pixels does not count.
    """
    inner = slice(margin, -margin or None)
    row = {"view": view, "other": other, "ours": ours, "reference": reference}
    parts = {name: picture[:, inner, inner].nan_to_num(0, 0, 0) for name, picture in row.items() if picture is not None}
    # The square of the greatest mean error.
    error = (parts["ours"] - parts["reference"]).square().mean(0)
    side = min(SIDE, *error.shape)
    means = F.avg_pool2d(error[None, None], side, stride=1)[0, 0]
    top, left = divmod(int(means.argmax()), means.shape[1])
    parts = {name: part[:, top : top + side, left : left + side] for name, part in parts.items()}
    difference = (parts["ours"] - parts["reference"]).abs()
    # The largest power of two by which no difference is cut.
    factor = 2 ** math.floor(math.log2(1 / max(float(difference.max()), 1 / MOST_AMPLIFIED)))
    parts[f"difference_{factor}"] = difference * factor
    for name, part in parts.items():
        shown = pictures.for_display(part, encoding=NONE)
        images.write_image(folder / CROPS / f"{name}.png", np.ascontiguousarray(shown))


def read_crops(folder: Path, answer: Answer) -> Mapping[str, Path]:
    """Caption -> picture of the crops of an answer; empty if the run wrote none."""
    captions = {
        "view": "Centre view",
        "other": answer.other or "",
        "ours": answer.ours,
        "reference": "Truth" if answer.reference in TRUTHS else f"{answer.reference}, which is not the truth",
    }
    files = {caption: folder / CROPS / f"{name}.png" for name, caption in captions.items()}
    for file in (folder / CROPS).glob("difference_*.png"):
        files[f"Difference \N{MULTIPLICATION SIGN} {file.stem.partition('_')[2]}"] = file
    return {caption: file for caption, file in files.items() if file.is_file()}
