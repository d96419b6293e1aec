"""How near one stack is to another, plane by plane: against label sources, against exact Fourier refocusing."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import pandas as pd
from torch import Tensor

from lfref import geometry
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim
from lfref.geometry import FocalPlanes

Row = dict[str, Any]
"""One line of what becomes a table."""

MEASURES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "psnr_db": lambda stack, reference: psnr(stack, reference).mean(),
    "ssim": lambda stack, reference: ssim(stack, reference).mean(),
    "max_error": lambda stack, reference: (stack - reference).abs().max(),
}
"""What a stack is judged by, by the name of the column; means over the planes."""


def interior(stack: Tensor, slopes: Tensor, grid: tuple[int, int]) -> Tensor:
    """The part of a stack [N, C, H, W] that every view covers at every plane, whatever the border rule."""
    margin = math.ceil(geometry.corner_shift(slopes, grid))
    return stack[..., margin : stack.shape[-2] - margin, margin : stack.shape[-1] - margin]


def plane_rows(
    light_field: str, stacks: Mapping[str, Tensor], labels: Mapping[str, Tensor], planes: FocalPlanes
) -> Iterator[Row]:
    """Compare every stack with every label, over the whole frame as the paper does.

    Args:
        light_field: Name of the light field.
        stacks: What to judge, a stack [N, C, H, W] for each method.
        labels: What to judge by, a stack for each label source.
        planes: What the planes are.

    Yields:
        Rows `light_field, method, reference, alpha, slope, psnr_db, ssim`, one a plane.
    """
    for (method, stack), (reference, label) in itertools.product(stacks.items(), labels.items()):
        names = {"light_field": light_field, "method": method, "reference": reference}
        qualities = zip(psnr(stack, label).tolist(), ssim(stack, label).tolist(), strict=True)
        for place, (decibels, similarity) in zip(plane_names(planes), qualities, strict=True):
            yield names | place | {"psnr_db": decibels, "ssim": similarity}


def plane_names(planes: FocalPlanes) -> list[Row]:
    """What tables call each plane: its `alpha`, None where it was not written as one, and its `slope`."""
    alphas = planes.alphas or [None] * len(planes)
    return [{"alpha": alpha, "slope": slope} for alpha, slope in zip(alphas, planes.values, strict=True)]


def summaries(planes: pd.DataFrame) -> pd.DataFrame:
    """MPSNR and MSSIM of every light field, method and reference: the means over the planes (the paper's Eq. 4-5).

    Args:
        planes: Rows as from `plane_rows`.

    Returns:
        Columns `light_field, method, reference, mpsnr_db, mssim`.
    """
    groups = planes.groupby(["light_field", "method", "reference"], sort=False)
    return groups.agg(mpsnr_db=("psnr_db", "mean"), mssim=("ssim", "mean")).reset_index()


def interior_quality(
    stack: Tensor, reference: Tensor, slopes: Tensor, grid: tuple[int, int], measures: Sequence[str]
) -> dict[str, float]:
    """How near a stack is where every view covers every plane.

    Args:
        stack: [N, C, H, W].
        reference: [N, C, H, W].
        slopes: In pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
        measures: Keys of `MEASURES`.
    """
    inner, wanted = interior(stack, slopes, grid), interior(reference, slopes, grid)
    return {name: float(MEASURES[name](inner, wanted)) for name in measures}
