"""What a comparison of methods answers, in one sentence: how much better is ours than the best classical method?

"Ours" is the best network, and before all else it must be better than no refocusing, the mean of the views; that is no
competitor of the others. Without a network, or without a classical method, ours is the best of all, beside the next.
A method is no evidence about itself: rows that a method judges of its own pictures are left out. Only the truth, the
picture of a lens, says which method is better; by any other reference, one is only nearer to it than another.
"""

from typing import NamedTuple

import pandas as pd

from lfref.bench import accuracy
from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH
from lfref.report import tables
from lfref.report.tables import TRUTHS

SERIES = ["method", "reference"]
"""Columns whose values name one mean."""
SAME_DB = 0.05
"""Difference in dB below which the sentence calls two methods equal: it has one decimal."""


class Answer(NamedTuple):
    """A comparison of our method with another, over scenes or light fields."""

    kind: str
    """Class of the scenes; empty for an evaluation, which has no classes."""
    reference: str
    ours: str
    other: str | None
    """The method that ours is compared with; None: there is no other."""
    worst: str
    """The scene where ours is the farthest from the reference."""
    sentence: str
    """The answer with its figures."""


def of_evaluation(summary: pd.DataFrame, planes: pd.DataFrame) -> Answer | None:
    """The answer for the rendered label, which is the truth, else for the first one; None without methods.

    The summary has `is_network` beside the columns of `accuracy.summaries`; planes are rows of `accuracy.plane_rows`.
    """
    rows = summary.rename(columns={"light_field": "scene", "mpsnr_db": "psnr_db"}).assign(**{"class": ""})
    means = rows.groupby([*SERIES, "class", "is_network"], sort=False)["psnr_db"].mean().reset_index()
    return of_bench(means.join(accuracy.explained(planes, SERIES), on=SERIES), rows)


def of_bench(bench: pd.DataFrame, scenes: pd.DataFrame) -> Answer | None:
    """The answer of the first class that the truth judges, else of the first class; None without methods.

    Columns are `method`, `class`, `reference`, `psnr_db`; `is_network`, and perhaps `numpy_ffts` and those of
    `accuracy.explained`, for the bench; `scene` for the scenes.
    """
    rows = tables.judged_by_others(bench.dropna(subset=["class", "psnr_db"]))
    rows = rows[rows["method"] != RIVAL]
    if rows.empty:
        return None
    by_truth = rows[rows["reference"].isin(TRUTHS)]
    kind, reference = (rows if by_truth.empty else by_truth)[["class", "reference"]].iloc[0]
    rows = rows[(rows["class"] == kind) & (rows["reference"] == reference)].sort_values("psnr_db", ascending=False)
    ours, other = _ours_and_other(rows)
    of_ours = scenes[(scenes["class"] == kind) & (scenes["reference"] == reference) & (scenes["method"] == ours.method)]
    scores = of_ours.groupby("scene", sort=False)["psnr_db"].mean()
    where = f"{len(scores)} {f'scenes ({kind})' if reference == TRUTH and kind else 'light fields'}"
    sentence = f"On {where if len(scores) > 1 else scores.index[0]}"
    if reference not in TRUTHS:
        sentence += f", judged by {reference} and not by the truth"
    sentence += f", {ours.method} {_against_mean(ours)}{_compared(ours, other, reference)}"
    if len(scores) > 1:
        sentence += f", worst on {scores.idxmin()} ({scores.min():.1f} dB)"
    if "numpy_ffts" in rows:
        against = "" if other is None else f" against {other.numpy_ffts:.2g}"
        sentence += f", at {ours.numpy_ffts:.2g} units of time{against}"
    name = None if other is None else str(other.method)
    return Answer(str(kind), str(reference), str(ours.method), name, str(scores.idxmin()), f"{sentence}.")


def _ours_and_other(ranked: pd.DataFrame) -> tuple[pd.Series, pd.Series | None]:
    """The best network and the best classical method; without one of them, the best two of all."""
    networks, classical = ranked[ranked["is_network"]], ranked[~ranked["is_network"]]
    if len(networks) and len(classical):
        return networks.iloc[0], classical.iloc[0]
    return ranked.iloc[0], ranked.iloc[1] if len(ranked) > 1 else None


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
    rank = f"the {'best' if is_truth else 'nearest'} classical method" if ours.is_network > other.is_network else ""
    named = f"{rank or 'the next method'}, {other.method}"
    if abs(gain) < SAME_DB:
        return f"is {'as good' if is_truth else f'as near to {reference}'} as {named}"
    above, below = ("better", "worse") if is_truth else ("nearer to it", "farther from it")
    return f"is {abs(gain):.1f} dB {above if gain > 0 else below} than {named}"
