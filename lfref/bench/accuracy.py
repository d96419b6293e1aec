"""How near one stack is to another, plane by plane: against label sources, against exact Fourier refocusing."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim
from lfref.geometry import FocalPlanes

Row = dict[str, object]
"""One line of a table."""


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
        qualities = zip(psnr(stack, label).tolist(), ssim(stack, label).tolist(), strict=True)
        alphas = planes.alphas or [None] * len(planes)
        for alpha, slope, (decibels, similarity) in zip(alphas, planes.values, qualities, strict=True):
            yield {
                "light_field": light_field,
                "method": method,
                "reference": reference,
                "alpha": alpha,
                "slope": slope,
                "psnr_db": decibels,
                "ssim": similarity,
            }


def summaries(rows: Iterable[Row]) -> list[Row]:
    """MPSNR and MSSIM of every light field, method and reference: the means over the planes (the paper's Eq. 4-5).

    Args:
        rows: As from `plane_rows`.

    Returns:
        Rows `light_field, method, reference, mpsnr_db, mssim`.
    """
    groups: dict[tuple[object, object, object], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["light_field"], row["method"], row["reference"]), []).append(row)
    return [
        {
            "light_field": field,
            "method": method,
            "reference": reference,
            "mpsnr_db": _mean(members, "psnr_db"),
            "mssim": _mean(members, "ssim"),
        }
        for (field, method, reference), members in groups.items()
    ]


def interior_quality(stack: Tensor, reference: Tensor, slopes: Tensor, grid: tuple[int, int]) -> tuple[float, float]:
    """PSNR in dB and SSIM, means over the planes, where every view covers every plane.

    Args:
        stack: [N, C, H, W].
        reference: [N, C, H, W].
        slopes: In pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
    """
    inner, wanted = interior(stack, slopes, grid), interior(reference, slopes, grid)
    return float(psnr(inner, wanted).mean()), float(ssim(inner, wanted).mean())


def interior_errors(stack: Tensor, reference: Tensor, slopes: Tensor, grid: tuple[int, int]) -> tuple[float, float]:
    """PSNR in dB, mean over the planes, and the largest difference, where every view covers every plane.

    Args:
        stack: [N, C, H, W].
        reference: [N, C, H, W].
        slopes: In pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
    """
    inner, wanted = interior(stack, slopes, grid), interior(reference, slopes, grid)
    return float(psnr(inner, wanted).mean()), float((inner - wanted).abs().max())


def _mean(rows: list[Row], column: str) -> float:
    return float(torch.tensor([row[column] for row in rows], dtype=torch.float64).mean())
