"""1 - SSIM of planes, differentiable: the formula in PyTorch, and the compiled one that stands in for it on the CPU.

Both compute in float64, whatever the images' type, so that only the result is rounded. Letters: as in `ssim`.
"""

from collections.abc import Callable
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from lfref.functional import ssim_kernel, threads
from lfref.functional.ssim_kernel import RADIUS

WORTH_A_THREAD = 1 << 17
"""Pixels from which one more thread saves more than it costs."""


def plane_values(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
    """1 - SSIM of each plane.

    Args:
        x: Planes, float32 or float64, [P, H, W].
        y: Planes of the same shape and type.
        C1: Stabiliser of the luminance.
        C2: Stabiliser of contrast and structure.

    Returns:
        Float64, [P]; differentiable twice.
    """
    if x.device.type != "cpu":
        return formula(x, y, C1, C2)
    asked = [torch.is_grad_enabled() and each.requires_grad for each in (x, y)]
    values, *_ = _Values.apply(x, y, C1, C2, *asked)
    return values


def formula(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
    """What `plane_values` returns, by PyTorch's own operations."""
    (mu_d, mu_s), (var_d, var_s) = _local_statistics(x.double(), y.double())
    # mu_x^2 + mu_y^2 = (mu_s^2 + mu_d^2) / 2; numerators and denominators carry a factor of 2.
    squared = mu_d.square()
    a = 2 * squared / (mu_s.square() + squared + 2 * C1)
    b = 2 * var_d / (var_s + var_d + 2 * C2)
    return (a + b - a * b).mean((-2, -1))


def _local_statistics(x: Tensor, y: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Local means and variances of x - y and x + y, each [P, H, W]: ((mu_d, mu_s), (var_d, var_s)).

    Each is centred by its plane's mean first, or the squares of a bright plane would swamp its variance. The result
    does not depend on what was subtracted, so no gradient need flow through it.
    """
    centre_x, centre_y = (planes.detach().mean((-2, -1), keepdim=True) for planes in (x, y))
    centre_d, centre_s = centre_x - centre_y, centre_x + centre_y
    mean, square = _window_means(torch.cat((x - y - centre_d, x + y - centre_s)))
    variance = (square - mean.square()).clamp(min=0)
    mu_d, mu_s = mean.chunk(2)
    return (mu_d + centre_d, mu_s + centre_s), variance.chunk(2)


def _window_means(planes: Tensor) -> tuple[Tensor, ...]:
    """Gaussian local means of the planes and of their squares, [P, H, W] -> two of [P, H, W]."""
    padded = F.pad(planes, (RADIUS,) * 4, mode="reflect")
    # Planes as channels of one image: a depthwise convolution.
    stacked = torch.cat((padded, padded.square()))[None]
    n_planes, window = stacked.shape[1], torch.from_numpy(ssim_kernel.window()).to(stacked)
    rows = F.conv2d(stacked, window.expand(n_planes, 1, 1, -1), groups=n_planes)
    both = F.conv2d(rows, window[:, None].expand(n_planes, 1, -1, 1), groups=n_planes)
    return both[0].chunk(2)


@torch.library.custom_op("lfref::one_minus_ssim", mutates_args=(), device_types="cpu")
def _compiled(x: Tensor, y: Tensor, C1: float, C2: float, for_x: bool, for_y: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Values and, on the way, their gradient: made apart, it would take all steps to the values once more."""
    results = _room(x, y, C1, C2, for_x, for_y)
    planes = [each.contiguous().numpy() for each in (x, y)]
    plan, (values, *gradients) = ssim_kernel.plan(x.shape[1], x.shape[2], C1, C2), [each.numpy() for each in results]

    def work(first: int, last: int) -> None:
        part = slice(first, last)
        parts = [each[part] for each in planes]
        if for_x or for_y:
            ssim_kernel.set_values_and_gradients(*parts, plan, values[part], *(each[part] for each in gradients))
        else:
            ssim_kernel.set_values(*parts, plan, values[part])

    _share(work, x)
    return results


@_compiled.register_fake
def _room(x: Tensor, y: Tensor, C1: float, C2: float, for_x: bool, for_y: bool) -> tuple[Tensor, Tensor, Tensor]:
    values, nothing = x.new_empty(len(x), dtype=torch.float64), (len(x), 0, 0)
    g_x, g_y = (x.new_empty(x.shape if asked else nothing) for asked in (for_x, for_y))
    return values, g_x, g_y


def _share(work: Callable[[int, int], None], planes: Tensor) -> None:
    """Call `work` with first and last plane: plain threads, as many as PyTorch has, each with its share of planes.

    Which thread computes a plane changes no digit of it.
    """
    n_threads = min(threads.worthwhile(planes.numel(), WORTH_A_THREAD), max(len(planes), 1))
    threads.share(work, threads.bands(len(planes), n_threads), n_threads)


class _Values(torch.autograd.Function):
    """The compiled values, with the compiled gradient."""

    @staticmethod
    def forward(x: Tensor, y: Tensor, C1: float, C2: float, *asked: bool) -> tuple[Tensor, Tensor, Tensor]:
        values, g_x, g_y = _compiled(x, y, C1, C2, *asked)
        return values, g_x, g_y

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor, Tensor]) -> None:
        x, y, *ctx.constants = inputs[:4]
        ctx.mark_non_differentiable(*output[1:])
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(x, y, *output[1:])

    @staticmethod
    def backward(ctx: Any, weights: Tensor | None, *_: None) -> Any:
        if weights is None:
            return (None,) * 6
        gradients = _Gradients.apply(*ctx.saved_tensors, weights, *ctx.constants)
        asked = zip(gradients, ctx.needs_input_grad, strict=False)
        return *(gradient if needed else None for gradient, needed in asked), None, None, None, None


class _Gradients(torch.autograd.Function):
    """The weighted gradient; its own, rarely asked for, comes from the formula."""

    @staticmethod
    def forward(
        x: Tensor, y: Tensor, g_x: Tensor, g_y: Tensor, weights: Tensor, C1: float, C2: float
    ) -> tuple[Tensor, Tensor]:
        shares = weights[:, None, None].to(x)
        return g_x * shares, g_y * shares

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        x, y, _, _, weights, *ctx.constants = inputs
        ctx.save_for_backward(x, y, weights)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *further: Tensor) -> Any:
        with torch.enable_grad():
            x, y, weights = (tensor.detach().requires_grad_() for tensor in ctx.saved_tensors)
            both = torch.autograd.grad(formula(x, y, *ctx.constants), (x, y), weights, create_graph=True)
        # A gradient that was not asked for is empty, and has none of its own.
        asked = [(first, second) for first, second in zip(both, further, strict=True) if first.shape == second.shape]
        gradients, seconds = zip(*asked, strict=True)
        g_x, g_y, g_weights = torch.autograd.grad(gradients, (x, y, weights), seconds)
        return g_x, g_y, None, None, g_weights, None, None
