"""What a comparison of methods answers, in one sentence: how much better is ours than the best classical method?

"Ours" is the best network, and before all else it must be better than no refocusing, the mean of the views; that is no
competitor of the others. Without a network, or without a classical method, ours is the best of all, beside the next.
A method is no evidence about itself: rows that a method judges of its own pictures are left out. Only the truth, the
picture of a lens, says which method is better; by any other reference, one is only nearer to it than another.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from lfref.bench import accuracy
from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH
from lfref.errors import InputError
from lfref.report import tables
from lfref.report.tables import TRUTHS

SERIES = ["method", "reference"]
"""Columns whose values name one mean."""
SAME_DB = 0.05
"""Difference in dB below which the sentence calls two methods equal: it has one decimal."""


@dataclass(frozen=True)
class Answer:
    """A comparison of our method with another, over scenes or light fields."""

    kind: str
    """Class of the scenes; empty for an evaluation, which has no classes."""
    reference: str
    ours: str
    other: str | None
    """The method that ours is compared with; None: there is no other."""
    other_is_best_classical: bool
    gain_db: float | None
    """PSNR of ours less that of the other; None: there is no other."""
    scores: Mapping[str, float]
    """Scene -> PSNR of ours in dB."""
    times: Sequence[float]
    """Times of ours and of the other in `numpy_ffts`; empty where none were measured."""
    explained: float = math.nan
    """Share of refocusing that our network explains; NaN: unknown, or no network."""
    explained_wide: float = math.nan
    """The same of planes of wide blur."""

    @property
    def is_below_mean(self) -> bool:
        """Whether our network is worse than the mean of the views."""
        return self.explained < 0

    @property
    def worst(self) -> str:
        """The scene where ours is the farthest from the reference."""
        return min(self.scores, key=lambda scene: self.scores[scene])

    @property
    def sentence(self) -> str:
        """The answer in one sentence with its figures."""
        n_scenes, what = len(self.scores), "light fields"
        if self.reference == TRUTH and self.kind:
            what = f"scenes ({self.kind})"
        where = f"On {n_scenes} {what}" if n_scenes > 1 else f"On {self.worst}"
        if self.reference not in TRUTHS:
            where += f", judged by {self.reference} and not by the truth"
        worst = f", worst on {self.worst} ({self.scores[self.worst]:.1f} dB)" if n_scenes > 1 else ""
        return f"{where}, {self.ours} {self._against_mean}{self._compared}{worst}{self._cost}."

    @property
    def _against_mean(self) -> str:
        if math.isnan(self.explained):
            return ""
        if self.is_below_mean:
            times = f"its squared error is {1 - self.explained:.2g} times that of {RIVAL}"
            return f"is worse than no refocusing at all ({times}, explained {self.explained:.2g}) and "
        wide = "" if math.isnan(self.explained_wide) else f" (wide blur {100 * self.explained_wide:.3g} %)"
        return f"explains {100 * self.explained:.3g} % of refocusing{wide} and "

    @property
    def _compared(self) -> str:
        if self.gain_db is None:
            return f"has {sum(self.scores.values()) / len(self.scores):.1f} dB"
        first = "best" if self.reference in TRUTHS else "nearest"
        rank = f"the {first} classical method" if self.other_is_best_classical else "the next method"
        if abs(self.gain_db) < SAME_DB:
            words = "as good as" if self.reference in TRUTHS else f"as near to {self.reference} as"
            return f"is {words} {rank}, {self.other}"
        above, below = ("better", "worse") if self.reference in TRUTHS else ("nearer to it", "farther from it")
        return f"is {abs(self.gain_db):.1f} dB {above if self.gain_db > 0 else below} than {rank}, {self.other}"

    @property
    def _cost(self) -> str:
        if not self.times:
            return ""
        unit, *others = (f"{time:.2g}" for time in self.times)
        return f", at {unit} units of time" + "".join(f" against {other}" for other in others)


def of_bench(bench: pd.DataFrame, scenes: pd.DataFrame) -> Answer | None:
    """The answer of the first class that the truth judges, else of the first class; None without methods.

    Args:
        bench: Columns `method`, `class`, `reference`, `psnr_db`, `numpy_ffts`, those of `accuracy.explained` (may be
            missing), and `is_network` (missing: no network).
        scenes: Columns `method`, `class`, `reference`, `scene`, `psnr_db`.
    """
    tables.require(scenes, "method", "class", "reference", "scene", "psnr_db")
    rows = tables.judged_by_others(tables.with_numbers(bench, "psnr_db").dropna(subset=["class"]))
    if rows.empty:
        return None
    rows = rows.sort_values("reference", key=lambda names: ~names.isin(TRUTHS), kind="stable")
    kind, reference = rows[["class", "reference"]].iloc[0]
    rows = rows[(rows["class"] == kind) & (rows["reference"] == reference)]
    per_scene = scenes[(scenes["class"] == kind) & (scenes["reference"] == reference)]
    return _answer(str(kind), str(reference), rows, per_scene, ("psnr_db", "scene"))


def of_evaluation(summary: pd.DataFrame, planes: pd.DataFrame) -> Answer | None:
    """The answer for the rendered label, which is the truth, else for the first one; None without methods.

    Args:
        summary: Columns `method`, `reference`, `light_field`, `mpsnr_db`, and `is_network` (missing: no network).
        planes: Columns `method`, `reference`, `slope`, `psnr_db`; a row per plane of each light field.
    """
    rows = tables.judged_by_others(tables.with_numbers(summary, "mpsnr_db"))
    if rows.empty:
        return None
    rows = rows.sort_values("reference", key=lambda names: ~names.isin(TRUTHS), kind="stable")
    rows = tables.capped(rows[rows["reference"] == rows["reference"].iloc[0]], "mpsnr_db")
    tables.require(planes, *SERIES, "slope", "psnr_db")
    means = rows.assign(is_network=networks(rows)).groupby(SERIES, sort=False, as_index=False)
    means = means.agg(mpsnr_db=("mpsnr_db", "mean"), is_network=("is_network", "first"))
    means = means.join(accuracy.explained(planes, SERIES), on=SERIES)
    return _answer("", str(rows["reference"].iloc[0]), means, rows, ("mpsnr_db", "light_field"))


def networks(rows: pd.DataFrame) -> pd.Series:
    """Whether the method of each row is a network; a table of an earlier version does not say so."""
    return rows["is_network"].astype(str) == "True" if "is_network" in rows else pd.Series(False, index=rows.index)


def _answer(
    kind: str, reference: str, methods: pd.DataFrame, per_scene: pd.DataFrame, columns: tuple[str, str]
) -> Answer | None:
    """The answer of methods of one reference; `columns` are those of the score and of the scene."""
    score, scene = columns
    ranked = methods[methods["method"] != RIVAL].sort_values(score, ascending=False, kind="stable")
    if ranked.empty:
        return None
    is_network = networks(ranked)
    is_mixed = bool(is_network.any() and not is_network.all())
    order = [ranked[is_network].iloc[0], ranked[~is_network].iloc[0]] if is_mixed else [*ranked.iloc[:2].iloc]
    ours, *others = (str(row["method"]) for row in order)
    gain = float(order[0][score] - order[1][score]) if others else None
    of_ours = per_scene[per_scene["method"] == ours].groupby(scene, sort=False)[score].mean().dropna()
    if of_ours.empty:
        raise InputError(f"the table of scenes must have the PSNR of {ours}", got="no number")
    times = [float(row["numpy_ffts"]) for row in order] if "numpy_ffts" in methods else []
    shares = [float(order[0].get(name, math.nan)) for name in ("explained", "explained_wide") if is_network.any()]
    other = others[0] if others else None
    return Answer(kind, reference, ours, other, is_mixed, gain, of_ours.to_dict(), times, *shares)
