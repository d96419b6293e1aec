"""Comparison of a file with its refocuser: scenes, odd sizes, several fields at once, flat frames."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch

from lfref.engines.engine import BF16, FP16, FP32, INT8, Inputs, NetworkFunction
from lfref.export.graphs import Exportable
from lfref.functional.psnr import psnr
from lfref.lightfield import LightField

FLAT = {"black": 0.0, "grey": 0.5, "white": 1.0}
"""Light of frames without any content."""
FLAT_DB = 25.0
"""Least PSNR of flat frames in low precision: a network that normalises amplifies its own rounding there."""
NOISE = 1e-4
"""Distance of float32 from float64 beyond which pictures of a flat frame count as amplified rounding."""
CLOSER_DB, CORRECTED_DB = 6.0, 90.0
"""A refiner's file must be 6 dB nearer to the refiner than the uncorrected pictures are, unless these are within 90 dB:
corrections are small, and a file without any would pass on many scenes."""
Row = dict[str, Any]


class Tolerance(NamedTuple):
    """Largest differences that are allowed between the pictures of a file and of its refocuser."""

    error: float = math.inf
    """Largest distance, in light."""
    psnr_db: float = 0.0
    """Least PSNR."""
    own: float = 0.0
    """Largest distance on flat frames that are amplified rounding, in units of float32's distance from float64."""


TOLERANCES = {
    FP32: Tolerance(error=1e-4, own=4.0),
    FP16: Tolerance(psnr_db=50),
    BF16: Tolerance(psnr_db=50),
    INT8: Tolerance(psnr_db=40),
}
"""Tolerance of each precision."""


class ParityCase(NamedTuple):
    """Light fields to refocus at once."""

    name: str
    """Name of the scene, or of the special case."""
    n_fields: int
    size: tuple[int, int]
    """Height and width, in pixels."""
    inputs: Inputs
    """Inputs of the graph."""


def cases(subject: Exportable, fields: Sequence[LightField]) -> Iterator[ParityCase]:
    """Every light field, four orientations of the first at once, and flat frames of its size."""
    first = fields[0]
    turned = [replace(first, views=first.views.flip(axes)) for axes in ((), (-1,), (-2,), (-1, -2))]
    groups = [(field.name, [field]) for field in fields] + [("turned", turned)]
    groups += [(name, [replace(first, views=torch.full_like(first.views, light))]) for name, light in FLAT.items()]
    for name, group in groups:
        for part in [group] if subject.reads_batches else [[field] for field in group]:
            yield ParityCase(name, len(part), part[0].size, subject.inputs(part))


@torch.no_grad()
def rows(subject: Exportable, runs: Mapping[str, NetworkFunction], cases: Iterable[ParityCase]) -> Iterator[Row]:
    """Compare the pictures of every engine, by name, with the pictures of lfref, case by case.

    Errors are in light. A stack that is not finite has an infinite error. `own_error` is the distance of lfref's
    float32 from its float64 on flat frames, else 0. `before_db` is the PSNR between the pictures before and after a
    refiner's correction, else 0.
    """
    for case in cases:
        stack = subject.reference(*case.inputs)
        own = float((subject.exact(*case.inputs) - stack).abs().max()) if case.name in FLAT else 0.0
        before = 0.0
        if subject.uncorrected is not None:
            before = float(psnr(subject.uncorrected(*case.inputs), stack).min())
        for engine, run in runs.items():
            result = run(*case.inputs)
            error, psnr_db = math.inf, -math.inf
            if result.shape == stack.shape and bool(result.isfinite().all()):
                error = float((subject.in_light(result) - subject.in_light(stack)).abs().max())
                psnr_db = float(psnr(result, stack).min())
            yield {
                "engine": engine,
                "case": case.name,
                "n_fields": case.n_fields,
                "height": case.size[0],
                "width": case.size[1],
                "max_error": error,
                "psnr_db": psnr_db,
                "own_error": own,
                "before_db": before,
            }


def worst(rows: Iterable[Row], tolerance: Tolerance) -> Row | None:
    """Of the rows that violate a tolerance, the one of the largest error; None if all rows meet it."""
    beyond = [row for row in rows if not _holds(row, tolerance)]
    return max(beyond, key=lambda row: row["max_error"], default=None)


def own_noise(rows: Iterable[Row]) -> dict[str, float]:
    """Flat frames on which rounding makes the subject noisy: case -> distance of its float32 from its float64."""
    return {row["case"]: row["own_error"] for row in rows if row["own_error"] > NOISE}


def _holds(row: Row, tolerance: Tolerance) -> bool:
    error, least_db = tolerance.error, tolerance.psnr_db
    if row["own_error"] > NOISE:
        error = max(error, tolerance.own * row["own_error"])
    if row["case"] in FLAT:
        # If float32 itself is that far from float64, no PSNR can be demanded of low precision.
        least_db = min(least_db, FLAT_DB) if row["own_error"] < 10 ** (-FLAT_DB / 20) else -math.inf
    if 0 < row["before_db"] < CORRECTED_DB:
        least_db = max(least_db, row["before_db"] + CLOSER_DB)
    return bool(math.isfinite(row["max_error"]) and row["max_error"] <= error and row["psnr_db"] >= least_db)
