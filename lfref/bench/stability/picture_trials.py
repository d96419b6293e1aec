"""Loss terms, the loss and the metrics as components, each beside its usual formulation.

Errors that are allowed are those the project has set itself, as absolute errors of each value.
Letters: `x y` prediction and target, [B, C, H, W].
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import torch
from torch import Tensor

from lfref.bench import timing
from lfref.bench.stability import catalogue, oracles, trials, usual
from lfref.bench.stability.catalogue import noise
from lfref.bench.stability.trials import OURS, PRECISIONS, Allowed, Component, Formulation, Precision
from lfref.functional.psnr import inverse_psnr, inverse_psnr_of_mse, psnr
from lfref.functional.ssim import one_minus_ssim, ssim
from lfref.losses.composite import PAPER_WEIGHTS, CompositeLoss, mean_absolute_error, mean_squared_error
from lfref.metrics.stack import MPSNR, MSSIM, StackQuality

# PART measures
# Single figures of the loss and the metrics: accuracy, monotony, survival of drawn images, time.
#
# Letters: `m` mean squared error, `x y` prediction and target.

CPU = torch.device("cpu")
MEANS, CONTRASTS = (0.0, 0.5, 0.9, 1.0, 64.0, 1000.0), (0.4, 0.1, 0.01, 0.001)


def error_of_paper_term(dtype: torch.dtype, n: int = 2001) -> float:
    """Largest relative error of 1 / PSNR from 8.69 to 100 dB, against the paper's formula in extended precision.

    Args:
        dtype: float64: of the function of m; float32: of images too.
        n: How many errors between the two ends.
    """
    m = torch.logspace(-10, math.log10(oracles.JOIN), n, dtype=torch.float64).clamp(oracles.FLOOR, oracles.JOIN)
    if dtype == torch.float64:
        return _relative_error(inverse_psnr_of_mse(m), m.numpy().astype(np.longdouble))
    x = m.sqrt().to(dtype)[:, None, None, None]
    exact = np.square(x.flatten().numpy().astype(np.longdouble))
    inside = (exact >= oracles.FLOOR) & (exact <= oracles.JOIN)
    return _relative_error(inverse_psnr(x, torch.zeros_like(x))[torch.from_numpy(inside)], exact[inside])


def _relative_error(got: Tensor, m: np.ndarray) -> float:
    right = -np.log(np.longdouble(10)) / 10 / np.log(m)
    return float(np.abs(got.numpy().astype(np.longdouble) / right - 1).max())


def error_of_ssim(form: Callable[[Tensor, Tensor], Tensor], precision: Precision) -> float:
    """Largest error of 1 - SSIM against the oracle, all means up to 1000, all contrasts.

    Args:
        form: (x, y) -> 1 - SSIM.
        precision: Type of the images, and autocast.
    """
    errors = []
    for mean, contrast in itertools.product(MEANS, CONTRASTS):
        pair = [(mean + contrast * noise(2, 3, 40, 44, seed=seed)).to(precision.dtype) for seed in (0, 1)]
        got = trials.attempt(form, tuple(pair), precision, has_gradient=False).values
        errors.append((got - oracles.one_minus_ssim(pair[0].double(), pair[1].double())).abs().max())
    return float(torch.stack(errors).max())


def difference_from_torchmetrics() -> float:
    """Largest difference between our SSIM and torchmetrics' on images that trouble neither."""
    target = 0.5 + 0.4 * noise(8, 3, 48, 56)
    pairs = [((target + error * noise(8, 3, 48, 56, seed=1)).float(), target.float()) for error in (0.01, 0.1, 0.4)]
    return max(float((ssim(*pair) - usual.ssim(*pair)).abs().max()) for pair in pairs)


def falls_of_loss(n: int = 20001) -> int:
    """How often the loss falls as the error grows, from m = 1e-30 to 1e6, all else alike.

    Args:
        n: How many errors.
    """
    error = torch.logspace(-15, 3, n, dtype=torch.float64).float()[:, None, None, None]
    losses = [term(error, torch.zeros_like(error)).double() for term in (inverse_psnr, oracles.mse, oracles.l1)]
    loss = CompositeLoss()
    coarse = error[:: n // 1000].expand(-1, 3, 8, 8)
    losses.append(torch.stack([loss(image, torch.zeros_like(image)) for image in coarse]).double())
    return sum(int((values.diff() < 0).sum()) for values in losses)


def drawn_pairs(n: int, seed: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
    """Pairs of images of any brightness, contrast and error, many of them degenerate.

    Args:
        n: How many.
        seed: Of the draw.

    Yields:
        Prediction and target, [1, 2, 7, 9], float32, float16 and bfloat16 in turn.
    """
    generator = torch.Generator().manual_seed(seed)
    dtypes = itertools.cycle(precision.dtype for precision in list(PRECISIONS.values())[:3])
    for dtype in itertools.islice(dtypes, n):
        level, contrast, error = (10 ** (torch.rand(3, generator=generator) * 9 - 6)).tolist()
        flat, equal, black = (torch.rand(3, generator=generator) < 0.2).tolist()
        first, second = (2 * torch.rand(2, 1, 2, 7, 9, generator=generator) - 1).unbind()
        target = 0 * first if black else min(level, 1000.0) + (0 if flat else min(contrast, 30.0)) * first
        prediction = target if equal else target + min(error, 100.0) * second
        yield prediction.to(dtype), target.to(dtype)


def share_that_survives(loss: Callable[[Tensor, Tensor], Tensor], n: int = 2000) -> float:
    """Share of drawn pairs whose loss and gradient are finite.

    Args:
        loss: (x, y) -> values.
        n: Pairs.
    """
    survived = 0
    for x, y in drawn_pairs(n):
        x.requires_grad_()
        value = loss(x, y).sum()
        (gradient,) = torch.autograd.grad(value, x)
        survived += bool(value.isfinite() & gradient.isfinite().all())
    return survived / n


def time_of_ssim(rounds: int = 5) -> float:
    """Time of 1 - SSIM forwards and backwards on the stack of one patch, as a share of torchmetrics'.

    Args:
        rounds: In which the two take turns, after one that does not count.
    """
    pair = tuple((0.5 + 0.4 * noise(1, 48, 192, 192, seed=seed)).float() for seed in (0, 1))
    forms: dict[str, Callable[[Tensor, Tensor], Tensor]] = {"ours": one_minus_ssim, "theirs": usual.one_minus_ssim}
    watches = {
        name: functools.partial(timing.seconds, functools.partial(_step, form, *pair), CPU)
        for name, form in forms.items()
    }
    times = timing.in_turns(watches, range(rounds + 1), warmup=1)
    # The fastest: whatever else a machine does only adds time.
    return min(times["ours"]) / min(times["theirs"])


def _step(form: Callable[[Tensor, Tensor], Tensor], x: Tensor, y: Tensor) -> None:
    x = x.clone().requires_grad_()
    form(x, y).sum().backward()


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
