"""Loss terms, the loss and the metrics as components, each beside its usual formulation.

Errors that are allowed are those the project has set itself, as absolute errors of each value.
Letters: `x y` prediction and target, [B, C, H, W].
"""

import functools
from collections.abc import Mapping

import torch
from torch import Tensor

from lfref.bench.stability import catalogue, oracles, usual
from lfref.bench.stability.trials import OURS, Allowed, Component, Formulation, Precision
from lfref.functional.psnr import inverse_psnr, psnr
from lfref.functional.ssim import one_minus_ssim
from lfref.losses.composite import PAPER_WEIGHTS, CompositeLoss, mean_absolute_error, mean_squared_error
from lfref.metrics.stack import MPSNR, MSSIM, StackQuality

RELATIVE = 1e-6
"""Error allowed of a value in float32, as a share of it."""


def _relative(right: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return RELATIVE * right.abs().clamp(min=torch.finfo(torch.float32).tiny)


def _decibel(right: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return RELATIVE * right.abs().clamp(min=1.0)


def _of_ssim_metric(right: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return torch.full_like(right, 1e-6)


def _of_ssim(right: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return torch.full_like(right, 1e-7 if precision.dtype == torch.float32 and precision.autocast is None else 1e-6)


def _of_inverse_psnr(right: Tensor, precision: Precision, x: Tensor, y: Tensor) -> Tensor:
    """Beyond 100 and 8.69 dB nothing fixes the value: a positive one of the same size will do."""
    m = oracles.mse(x, y)
    return torch.where((m < oracles.FLOOR) | (m > oracles.JOIN), right, RELATIVE * right)


def _of_composite(right: Tensor, precision: Precision, x: Tensor, y: Tensor) -> Tensor:
    of_term = _of_inverse_psnr(oracles.inverse_psnr(x, y), precision, x, y)
    return RELATIVE * right + PAPER_WEIGHTS["inverse_psnr"] * of_term


def _composite(x: Tensor, y: Tensor) -> Tensor:
    """The loss of each image, [B]."""
    loss = CompositeLoss()
    return torch.stack([loss(a, b) for a, b in zip(x, y, strict=True)])


def _metric(metric: type[StackQuality]) -> Formulation:
    """The metric of each image, [B]."""
    return lambda x, y: torch.stack([metric(n_planes=1)(a[None], b[None]) for a, b in zip(x, y, strict=True)])


def components() -> list[Component]:
    """The terms of the loss, the loss, and the metrics."""
    term = functools.partial(_component, takes_large=True)
    whole = functools.partial(_component, takes_large=False)
    metric = functools.partial(_component, takes_large=False, has_gradient=False)
    return [
        term("mse", {OURS: mean_squared_error, "textbook": usual.mse}, oracles.mse, _relative),
        term("l1", {OURS: mean_absolute_error, "textbook": usual.l1}, oracles.l1, _relative),
        term("1 - SSIM", {OURS: one_minus_ssim, **usual.SSIMS}, oracles.one_minus_ssim, _of_ssim),
        term("1 / PSNR", {OURS: inverse_psnr, "textbook": usual.inverse_psnr}, oracles.inverse_psnr, _of_inverse_psnr),
        whole("loss", {OURS: _composite, "textbook": usual.composite}, oracles.composite, _of_composite),
        term("PSNR", {OURS: psnr, "torchmetrics": usual.psnr}, oracles.psnr, _decibel),
        metric("MPSNR", {OURS: _metric(MPSNR), "torchmetrics": usual.psnr}, oracles.psnr, _decibel),
        metric("MSSIM", {OURS: _metric(MSSIM), "torchmetrics": usual.ssim}, oracles.ssim, _of_ssim_metric),
    ]


def _component(
    name: str,
    formulations: Mapping[str, Formulation],
    oracle: Formulation,
    allowed: Allowed,
    takes_large: bool,
    has_gradient: bool = True,
) -> Component:
    return Component(name, catalogue.IMAGES, formulations, oracle, allowed, takes_large, has_gradient)
