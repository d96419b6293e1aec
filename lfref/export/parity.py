"""Whether a file makes the pictures of what it was made of: scenes, odd sizes, degenerate frames, several at once."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from lfref.engines.engine import BF16, FP16, FP32, INT8, Inputs, Run
from lfref.export.graphs import Exportable
from lfref.functional.psnr import psnr
from lfref.lightfield import LightField

FLAT = {"black": 0.0, "grey": 0.5, "white": 1.0}
"""Light of frames that show nothing."""
FLAT_DB = 25.0
"""Least PSNR of these in low precision: what a network that normalises makes of them it makes of its own roundings."""
NOISE = 1e-4
"""How far float32 is from float64 where pictures of a flat frame are but a network's roundings, made large."""
CLOSER_DB, CORRECTED_DB = 6.0, 90.0
"""How much nearer to what a refiner makes a file of it must be than the pictures that it corrects, unless these are as
near as the latter: corrections are small, and a file without any would be near enough to many scenes."""
Row = dict[str, Any]


class Tolerance(NamedTuple):
    """How far a file may be from what it was made of."""

    error: float = math.inf
    """Largest distance, in light."""
    psnr_db: float = 0.0
    """Least PSNR."""
    own: float = 0.0
    """How many times as far it may be of a flat frame as float32 is from float64, where that is noise."""


TOLERANCES = {
    FP32: Tolerance(error=1e-4, own=4.0),
    FP16: Tolerance(psnr_db=50),
    BF16: Tolerance(psnr_db=50),
    INT8: Tolerance(psnr_db=40),
}
"""By precision."""


class Case(NamedTuple):
    """Something to refocus."""

    name: str
    """Of the scene, or of what is wrong with it."""
    n_fields: int
    size: tuple[int, int]
    """Height and width, in pixels."""
    inputs: Inputs
    """What the graph is given."""


def cases(subject: Exportable, fields: Sequence[LightField]) -> Iterator[Case]:
    """What a file is tried on: each light field, four at once, and frames that show nothing.

    Args:
        subject: What is exported.
        fields: Of as many sizes as it shall be tried at.
    """
    for field in fields:
        yield _case(field.name, [field], subject)
    first = fields[0]
    turned = [first.views.flip(axes) for axes in ((), (-1,), (-2,), (-1, -2))]
    yield _case("turned", [replace(first, views=views) for views in turned], subject)
    for name, light in FLAT.items():
        yield _case(name, [replace(first, views=torch.full_like(first.views, light))], subject)


def _case(name: str, fields: Sequence[LightField], subject: Exportable) -> Case:
    return Case(name, len(fields), fields[0].size, subject.inputs(fields))


@torch.no_grad()
def rows(subject: Exportable, runs: Mapping[str, Run], tried: Iterable[Case]) -> Iterator[Row]:
    """How far each engine is from what was exported, case by case.

    Args:
        subject: What was exported.
        runs: The file, by the names of the engines that run it.
        tried: Of `cases`.

    Yields:
        `engine, case, n_fields, height, width, max_error, psnr_db, own_error, before_db`; a stack that is not finite
        has an infinite error. `own_error` is how far, of flat frames, the subject in float32 is from itself in float64,
        else 0; `before_db` the PSNR of the pictures that a refiner corrects against what it makes of them, else 0.
    """
    for case in tried:
        stack = subject.wanted(*case.inputs)
        own = float((subject.exact(*case.inputs) - stack).abs().max()) if case.name in FLAT else 0.0
        before = 0.0 if subject.before is None else float(psnr(subject.before(*case.inputs), stack).min())
        for engine, run in runs.items():
            made = run(*case.inputs)
            place = {"engine": engine, "case": case.name, "n_fields": case.n_fields}
            size = dict(zip(("height", "width"), case.size, strict=True))
            yield place | size | _apart(made, stack) | {"own_error": own, "before_db": before}


def worst(found: Iterable[Row], tolerance: Tolerance) -> Row | None:
    """The row that is farthest beyond a tolerance; None: all hold it.

    Args:
        found: Of `rows`.
        tolerance: That they should hold.
    """
    beyond = [row for row in found if not _holds(row, tolerance)]
    return max(beyond, key=lambda row: row["max_error"], default=None)


def own_noise(found: Iterable[Row]) -> dict[str, float]:
    """Frames of which a subject makes noise of its own, case -> how far it is from itself in float64.

    Args:
        found: Of `rows`.
    """
    return {row["case"]: row["own_error"] for row in found if row["own_error"] > NOISE}


def _holds(row: Row, tolerance: Tolerance) -> bool:
    error, least = tolerance.error, tolerance.psnr_db
    if row["own_error"] > NOISE:
        error = max(error, tolerance.own * row["own_error"])
    if row["case"] in FLAT:
        # Where float32 is already as far from float64 as that, no precision can be held to it.
        least = min(least, FLAT_DB) if row["own_error"] < 10 ** (-FLAT_DB / 20) else -math.inf
    if 0 < row["before_db"] < CORRECTED_DB:
        least = max(least, row["before_db"] + CLOSER_DB)
    return bool(math.isfinite(row["max_error"]) and row["max_error"] <= error and row["psnr_db"] >= least)


def _apart(made: Tensor, wanted: Tensor) -> Row:
    if made.shape != wanted.shape or not bool(made.isfinite().all()):
        return {"max_error": math.inf, "psnr_db": -math.inf}
    return {"max_error": float((made - wanted).abs().max()), "psnr_db": float(psnr(made, wanted).min())}
