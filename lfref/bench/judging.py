"""Methods judged by truth: a row a plane of every subject and method, and what the rows come to.

Means are over decibels and never told alone: beside them stands the worst. Letters: `N` planes.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

import pandas as pd
import torch

from lfref.bench import accuracy, quality
from lfref.bench.accuracy import Row
from lfref.bench.quality import MEASURES, WHOLE
from lfref.bench.subjects import EXACT, Subject
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Refocuser

JUDGES = OperatorRefocuser(EXACT, exact_fourier)
SERIES = ["class", "method", "reference"]
COLUMNS = [*MEASURES, *(WHOLE + name for name in MEASURES), "exact_psnr_db"]
"""Measures of a row; the last one is PSNR against exact Fourier refocusing of the same views."""


@torch.no_grad()
def rows(subjects: Iterable[Subject], methods: Sequence[Refocuser], planes: FocalPlanes, margin: int) -> Iterator[Row]:
    """Judge every method on every subject.

    Args:
        subjects: Where the methods run.
        methods: Of different names.
        planes: Of the subjects' truths.
        margin: Width in pixels of the border that the interior lacks.

    Yields:
        Rows `class, scene, method, reference, alpha, slope` and `COLUMNS`, one a plane.

    Raises:
        InputError: The border leaves nothing to judge, or a method makes other planes.
    """
    for subject in subjects:
        quality.check_margin(margin, subject.light.size)
        truth, exact = subject.shown(subject.truth), subject.shown(subject.stack(JUDGES, planes.slopes))
        for method in methods:
            stack = subject.shown(subject.stack(method, planes.slopes))
            found = quality.planes(stack, truth, margin)
            found["exact_psnr_db"] = psnr(stack.inside(margin).stack, exact.inside(margin).stack).tolist()
            names = {"class": subject.kind, "scene": subject.light.name, "method": method.name}
            for place, *values in zip(accuracy.plane_names(planes), *found.values(), strict=True):
                yield names | {"reference": subject.reference} | place | dict(zip(found, values, strict=True))


def by_plane(judged: pd.DataFrame) -> pd.DataFrame:
    """Every plane over all scenes of a class.

    Args:
        judged: Of `rows`.

    Returns:
        Columns `class, method, reference, alpha, slope`, means of `COLUMNS`, and `worst_psnr_db, worst_scene`.
    """
    keys = [*SERIES, "alpha", "slope"]
    return _summary(judged, keys, worst_scene="scene")


def by_scene(judged: pd.DataFrame) -> pd.DataFrame:
    """Every scene over all its planes.

    Args:
        judged: Of `rows`.

    Returns:
        Columns `class, method, reference, scene`, means of `COLUMNS`, and `worst_psnr_db, worst_slope`.
    """
    return _summary(judged, [*SERIES, "scene"], worst_slope="slope")


def by_class(judged: pd.DataFrame) -> pd.DataFrame:
    """Every class over all its scenes and planes.

    Args:
        judged: Of `rows`.

    Returns:
        Columns `class, method, reference, scenes`, means of `COLUMNS`; the mean PSNR of the worst scene,
        `worst_psnr_db, worst_scene`; and `brightness_error`, the largest distance of the brightness of a plane from 1.
    """
    scenes = _summary(by_scene(judged), SERIES, worst_scene="scene")
    of_each = judged.assign(brightness_error=(judged["brightness"] - 1).abs()).groupby(SERIES, sort=False)
    more = of_each.agg(scenes=("scene", "nunique"), brightness_error=("brightness_error", "max"))
    return scenes.join(more, on=SERIES)


def _summary(table: pd.DataFrame, keys: list[str], **told: str) -> pd.DataFrame:
    """Means over groups of rows, the least PSNR of each, and where it is: new columns by the columns that say so."""
    # What is no number is worse than any.
    table = table.reset_index(drop=True).fillna({"psnr_db": -math.inf})
    groups = table.groupby(keys, sort=False, dropna=False)
    worst = table.loc[groups["psnr_db"].idxmin()]
    where = {name: worst[column].to_numpy() for name, column in told.items()}
    means = groups[COLUMNS].mean()
    return means.assign(worst_psnr_db=worst["psnr_db"].to_numpy(), **where).reset_index()
