"""1 - SSIM of planes, differentiable: the formula in PyTorch, and the compiled one that stands in for it on the CPU.

Both compute in float64, whatever the images' type, so that only the result is rounded. Letters: as in `ssim`.
"""

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from lfref.functional import ssim_kernel
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
    return _Values.apply(x, y, C1, C2) if x.device.type == "cpu" else formula(x, y, C1, C2)


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
def _compiled(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
    planes, values = (x.contiguous().numpy(), y.contiguous().numpy()), x.new_empty(len(x), dtype=torch.float64)
    plan, result = ssim_kernel.plan(x.shape[1], x.shape[2], C1, C2), values.numpy()

    def work(first: int, last: int) -> None:
        ssim_kernel.set_values(*(each[first:last] for each in planes), plan, result[first:last])

    _share(work, x)
    return values


@torch.library.custom_op("lfref::one_minus_ssim_gradients", mutates_args=(), device_types="cpu")
def _compiled_gradients(x: Tensor, y: Tensor, weights: Tensor, C1: float, C2: float) -> tuple[Tensor, Tensor]:
    given, results = (x, y, weights), (torch.empty_like(x).contiguous(), torch.empty_like(y).contiguous())
    arrays, gradients = [each.contiguous().numpy() for each in given], [each.numpy() for each in results]
    plan = ssim_kernel.plan(x.shape[1], x.shape[2], C1, C2)

    def work(first: int, last: int) -> None:
        part = slice(first, last)
        ssim_kernel.set_gradients(*(each[part] for each in arrays), plan, *(each[part] for each in gradients))

    _share(work, x)
    return results


def _share(work: Callable[[int, int], None], planes: Tensor) -> None:
    """Call `work` with first and last plane: plain threads, as many as PyTorch has, each with its share of planes.

    Which thread computes a plane changes no digit of it.
    """
    n_threads = max(1, min(torch.get_num_threads(), len(planes), planes.numel() // WORTH_A_THREAD))
    shares = list(itertools.pairwise(len(planes) * i // n_threads for i in range(n_threads + 1)))
    if n_threads == 1:
        work(*shares[0])
    else:
        with ThreadPoolExecutor(n_threads) as pool:
            list(pool.map(work, *zip(*shares, strict=True)))


@_compiled.register_fake
def _(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
    return x.new_empty(len(x), dtype=torch.float64)


@_compiled_gradients.register_fake
def _(x: Tensor, y: Tensor, weights: Tensor, C1: float, C2: float) -> tuple[Tensor, Tensor]:
    return torch.empty_like(x).contiguous(), torch.empty_like(y).contiguous()


class _Values(torch.autograd.Function):
    """The compiled values, with the compiled gradient."""

    @staticmethod
    def forward(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
        return _compiled(x, y, C1, C2)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        ctx.save_for_backward(*inputs[:2])
        ctx.constants = inputs[2:]

    @staticmethod
    def backward(ctx: Any, weights: Tensor) -> Any:
        return *_Gradients.apply(*ctx.saved_tensors, weights, *ctx.constants), None, None


class _Gradients(torch.autograd.Function):
    """The compiled gradient; its own, rarely asked for, comes from the formula."""

    @staticmethod
    def forward(x: Tensor, y: Tensor, weights: Tensor, C1: float, C2: float) -> tuple[Tensor, Tensor]:
        return _compiled_gradients(x, y, weights, C1, C2)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        ctx.save_for_backward(*inputs[:3])
        ctx.constants = inputs[3:]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_x: Tensor, g_y: Tensor) -> Any:
        with torch.enable_grad():
            x, y, weights = (tensor.detach().requires_grad_() for tensor in ctx.saved_tensors)
            gradients = torch.autograd.grad(formula(x, y, *ctx.constants), (x, y), weights, create_graph=True)
        return *torch.autograd.grad(gradients, (x, y, weights), (g_x, g_y)), None, None
