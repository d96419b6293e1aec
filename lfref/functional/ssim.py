"""Structural similarity of images, computed through 1 - SSIM without cancellation.

Letters: `x y` prediction and target, `d = x - y` and `s = x + y`; `mu` and `var` are their local Gaussian mean and
variance, `P` a plane (one channel of one image). With the constants of Wang et al. (2004),

    1 - SSIM = a + b - ab,    a = mu_d^2 / (mu_x^2 + mu_y^2 + C1),    b = var_d / ((var_s + var_d) / 2 + C2),

which holds the digits that 1 minus a number near 1 loses. Window and borders are those of torchmetrics
(Gaussian 11 x 11, sigma 1.5, K1 = .01, K2 = .03, reflection, mean over every pixel). All of it is computed in float64
and rounded once, also under autocast: a flat plane adds up the same rounding in every pixel.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from lfref.errors import InputError
from lfref.functional import threads
from lfref.functional.jit import compiled
from lfref.functional.psnr import check_data_range, image_pair

# PART ssim_kernel
# The compiled form of 1 - SSIM and of its gradient, row by row in float64: all that is between stays in the caches.
#
# A Gaussian mean with reflection, and its adjoint, are bands of 11 weights that depend on the place; one loop serves
# both. Letters: `x y` planes, `d = x - y`, `s = x + y`, `a b` as in `ssim`, `H W` rows and columns, `q` one of the four
# fields d, s, d^2, s^2, each centred by its plane's mean first; `g` derivatives of 1 - SSIM.

RADIUS = 5
"""Pixels that the window reaches to each side."""
SIGMA = 1.5
TAPS = 2 * RADIUS + 1

Reals = NDArray[np.floating]


class Bands(NamedTuple):
    """Weights of each place of an axis of n pixels for its neighbours, 0 beyond the ends."""

    mean: Reals
    """Of the local mean, [n, 11]."""
    adjoint: Reals
    """Of its adjoint, [n, 11]."""


class Plan(NamedTuple):
    """What the loops need besides the images."""

    rows: Bands
    """Along the columns' direction, [H, 11]."""
    mean: Reals
    """Along a row, a tap after the other, [11, W]."""
    adjoint: Reals
    """[11, W]."""
    C1: float
    C2: float


class Scratch(NamedTuple):
    """What one thread works in."""

    fields: Reals
    """A row of the four fields, continued by zeros beyond its ends, [4, 5 + W + 5]."""
    ring: Reals
    """The last 11 rows, summed along themselves, used in turn, [11, 4, W]."""
    row: Reals
    """A row summed along both axes, [4, W]."""


def window_of_ssim_kernel() -> NDArray[np.float64]:
    """Normalised Gaussian weights of one axis, [11]."""
    weights = np.exp(-(np.arange(-RADIUS, RADIUS + 1.0) ** 2) / (2 * SIGMA**2))
    return weights / weights.sum()


@functools.lru_cache(maxsize=32)
def bands(n: int) -> Bands:
    """The weights of an axis.

    Args:
        n: Its length, above `RADIUS` pixels.
    """
    places, mean = np.arange(n), np.zeros((n, n))
    for offset, weight in zip(range(-RADIUS, RADIUS + 1), window_of_ssim_kernel(), strict=True):
        mean[places, n - 1 - abs(n - 1 - abs(places + offset))] += weight
    return Bands(_band(mean), _band(mean.T))


def _band(matrix: NDArray) -> NDArray:
    """The 11 diagonals of a matrix, row by row, [n, n] -> [n, 11]."""
    padded = np.pad(matrix, ((0, 0), (RADIUS, RADIUS)))
    return np.stack([padded[i, i : i + TAPS] for i in range(len(matrix))])


def plan_of_ssim_kernel(height: int, width: int, C1: float, C2: float) -> Plan:
    """The tables for planes of one size."""
    across = bands(width)
    return Plan(bands(height), np.ascontiguousarray(across.mean.T), np.ascontiguousarray(across.adjoint.T), C1, C2)


@compiled
def set_values(x: Reals, y: Reals, plan: Plan, values: Reals) -> None:
    """1 - SSIM of each plane.

    Args:
        x: Planes, [P, H, W].
        y: Planes, [P, H, W].
        plan: Of their size.
        values: Is set, float64, [P].
    """
    _, height, width = x.shape
    scratch = _scratch(width)
    for p in range(len(x)):
        centres, total = (_mean(x[p]), _mean(y[p])), np.zeros(width)
        scratch.ring[:] = 0
        for i in range(height + RADIUS):
            if i < height:
                _center(x[p, i], y[p, i], centres, scratch.fields)
                _filter_row(scratch.fields, plan.mean, scratch.ring[i % TAPS])
            if i >= RADIUS:
                _filter_columns(scratch.ring, plan.rows.mean[i - RADIUS], i - RADIUS, scratch.row)
                _add_values(scratch.row, plan, centres, total)
        values[p] = total.sum() / (height * width)


@compiled
def set_values_and_gradients(x: Reals, y: Reals, plan: Plan, values: Reals, g_x: Reals, g_y: Reals) -> None:
    """1 - SSIM of each plane, and its gradient.

    Args:
        x: Planes, [P, H, W].
        y: Planes, [P, H, W].
        plan: Of their size.
        values: Is set, float64, [P].
        g_x: Is set, [P, H, W]; or [P, 0, 0].
        g_y: Is set, [P, H, W]; or [P, 0, 0].
    """
    _, height, width = x.shape
    means, slopes = _scratch(width), _scratch(width)
    for p in range(len(x)):
        centres, total = (_mean(x[p]), _mean(y[p])), np.zeros(width)
        means.ring[:], slopes.ring[:] = 0, 0
        # Rows come in, those whose neighbours have come are compared, and those whose neighbours have been go out.
        for i in range(height + 2 * RADIUS):
            middle, last = i - RADIUS, i - 2 * RADIUS
            if i < height:
                _center(x[p, i], y[p, i], centres, means.fields)
                _filter_row(means.fields, plan.mean, means.ring[i % TAPS])
            if 0 <= middle < height:
                _filter_columns(means.ring, plan.rows.mean[middle], middle, means.row)
                _add_values_and_set_slopes(means.row, plan, centres, total, slopes.fields[:, RADIUS:])
                _filter_row(slopes.fields, plan.adjoint, slopes.ring[middle % TAPS])
            if last >= 0:
                _filter_columns(slopes.ring, plan.rows.adjoint[last], last, slopes.row)
                for sign, g in ((1, g_x), (-1, g_y)):
                    if g.size:
                        _combine(x[p, last], y[p, last], centres, slopes.row, sign, g[p, last])
        values[p] = total.sum() / (height * width)


@compiled
def _scratch(width: int) -> Scratch:
    return Scratch(np.zeros((4, width + 2 * RADIUS)), np.zeros((TAPS, 4, width)), np.empty((4, width)))


@compiled
def _mean(plane: Reals) -> float:
    """Mean of a plane, column by column: many short sums at once."""
    total = np.zeros(plane.shape[1])
    for row in plane:
        for j in range(len(row)):
            total[j] += row[j]
    return total.sum() / plane.size


@compiled
def _center(x: Reals, y: Reals, centres: tuple[float, float], fields: Reals) -> None:
    """A row of d, s and their squares, each plane centred by its mean: a large one would swamp the variance."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    for j in range(len(x)):
        first, second = np.float64(x[j]), np.float64(y[j])
        d, s = first - second - centre_d, first + second - centre_s
        fields[0, RADIUS + j], fields[1, RADIUS + j] = d, s
        fields[2, RADIUS + j], fields[3, RADIUS + j] = d * d, s * s


@compiled
def _filter_row(fields: Reals, band: Reals, result: Reals) -> None:
    """Weighted sums along a row, [4, W + 10] -> [4, W]."""
    for q in range(4):
        row, total = fields[q], result[q]
        for j in range(len(total)):
            value = 0.0
            for k in range(TAPS):
                value += band[k, j] * row[j + k]
            total[j] = value


@compiled
def _filter_columns(ring: Reals, band: Reals, i: int, result: Reals) -> None:
    """Row i of the weighted sums down the columns, [11, 4, W] -> [4, W]."""
    for q in range(4):
        total = result[q]
        for j in range(len(total)):
            value = 0.0
            for k in range(TAPS):
                # Rows beyond the ends have weight 0; what lies in their places is another row, or zeros.
                value += band[k] * ring[(i + k + TAPS - RADIUS) % TAPS, q, j]
            total[j] = value


@compiled
def _add_values(row: Reals, plan: Plan, centres: tuple[float, float], total: Reals) -> None:
    """a + b - ab of a row."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    for j in range(len(total)):
        mean_d, mean_s = row[0, j], row[1, j]
        squared_d, squared_s = (mean_d + centre_d) ** 2, (mean_s + centre_s) ** 2
        var_d, var_s = _positive(row[2, j] - mean_d * mean_d), _positive(row[3, j] - mean_s * mean_s)
        # mu_x^2 + mu_y^2 = (mu_s^2 + mu_d^2) / 2; numerators and denominators carry a factor of 2.
        a = 2 * squared_d / (squared_s + squared_d + 2 * plan.C1)
        b = 2 * var_d / (var_s + var_d + 2 * plan.C2)
        total[j] += a + b - a * b


@compiled
def _add_values_and_set_slopes(
    row: Reals, plan: Plan, centres: tuple[float, float], total: Reals, slopes: Reals
) -> None:
    """a + b - ab of a row, and the derivatives of its mean with respect to the four local means, [4, W]."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    share = 1 / (len(plan.rows.mean) * len(total))
    for j in range(len(total)):
        mean_d, mean_s = row[0, j], row[1, j]
        mu_d, mu_s = mean_d + centre_d, mean_s + centre_s
        raw_d, raw_s = row[2, j] - mean_d * mean_d, row[3, j] - mean_s * mean_s
        var_d, var_s = _positive(raw_d), _positive(raw_s)
        luminance, structure = mu_s * mu_s + mu_d * mu_d + 2 * plan.C1, var_s + var_d + 2 * plan.C2
        a, b = 2 * mu_d * mu_d / luminance, 2 * var_d / structure
        total[j] += a + b - a * b
        g_a, g_b = 2 * share * (1 - b) / luminance, share * (1 - a) / structure
        # A variance that rounding made negative counts as 0 and has no slope.
        g_var_d, g_var_s = 0.0 if raw_d < 0 else (2 - b) * g_b, 0.0 if raw_s < 0 else -b * g_b
        slopes[0, j] = g_a * mu_d * (2 - a) - 2 * mean_d * g_var_d
        slopes[1, j] = -g_a * mu_s * a - 2 * mean_s * g_var_s
        slopes[2, j] = g_var_d
        slopes[3, j] = g_var_s


@compiled
def _positive(value: float) -> float:
    """The value, 0 instead of one below; not a number stays so."""
    return 0.0 if value < 0 else value


@compiled
def _combine(x: Reals, y: Reals, centres: tuple[float, float], fields: Reals, sign: int, g: Reals) -> None:
    """A row of the derivatives with respect to x (sign 1) or y (-1), from those of the four centred fields."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    for j in range(len(g)):
        first, second = np.float64(x[j]), np.float64(y[j])
        g_d = fields[0, j] + 2 * (first - second - centre_d) * fields[2, j]
        g_s = fields[1, j] + 2 * (first + second - centre_s) * fields[3, j]
        g[j] = g_s + sign * g_d


# PART ssim_planes
# 1 - SSIM of planes, differentiable: the formula in PyTorch, and the compiled one that stands in for it on the CPU.
#
# Both compute in float64, whatever the images' type, so that only the result is rounded. Letters: as in `ssim`.

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
    n_planes, window = stacked.shape[1], torch.from_numpy(window_of_ssim_kernel()).to(stacked)
    rows = F.conv2d(stacked, window.expand(n_planes, 1, 1, -1), groups=n_planes)
    both = F.conv2d(rows, window[:, None].expand(n_planes, 1, -1, 1), groups=n_planes)
    return both[0].chunk(2)


@torch.library.custom_op("lfref::one_minus_ssim", mutates_args=(), device_types="cpu")
def _compiled(x: Tensor, y: Tensor, C1: float, C2: float, for_x: bool, for_y: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Values and, on the way, their gradient: made apart, it would take all steps to the values once more."""
    results = _room(x, y, C1, C2, for_x, for_y)
    planes = [each.contiguous().numpy() for each in (x, y)]
    plan, (values, *gradients) = plan_of_ssim_kernel(x.shape[1], x.shape[2], C1, C2), [each.numpy() for each in results]

    def work(first: int, last: int) -> None:
        part = slice(first, last)
        parts = [each[part] for each in planes]
        if for_x or for_y:
            set_values_and_gradients(*parts, plan, values[part], *(each[part] for each in gradients))
        else:
            set_values(*parts, plan, values[part])

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


K1, K2 = 0.01, 0.03


def ssim(prediction: Tensor, target: Tensor, data_range: float = 1.0) -> Tensor:
    """Structural similarity of each image, averaged over its pixels and channels.

    Args:
        prediction: Images, [..., C, H, W], H and W at least 6 pixels.
        target: Images of the same shape.
        data_range: Difference between white and black, finite and above 0.

    Returns:
        SSIM, [-1, 1], 1 for identical images, float32 or the images' wider type, [...].

    Raises:
        InputError: The images are not comparable or too small, or data_range is not usable.

    Example:
        >>> image = torch.rand(3, 16, 16)
        >>> float(ssim(image, image))
        1.0
    """
    return 1 - one_minus_ssim(prediction, target, data_range)


def one_minus_ssim(prediction: Tensor, target: Tensor, data_range: float = 1.0) -> Tensor:
    """The complement of `ssim`, accurate also where the images hardly differ; this is the training loss.

    Args:
        prediction: Images, [..., C, H, W], H and W at least 6 pixels.
        target: Images of the same shape.
        data_range: Difference between white and black, finite and above 0.

    Returns:
        1 - SSIM, [0, 2], 0 for identical images, float32 or the images' wider type, [...].

    Raises:
        InputError: The images are not comparable or too small, or data_range is not usable.
    """
    check_data_range(data_range)
    x, y = image_pair(prediction, target)
    _check_size(x)
    constants = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    with torch.autocast(x.device.type, enabled=False):
        values = plane_values(_planes(x), _planes(y), *constants)
    return values.reshape(x.shape[:-2]).mean(-1).to(x.dtype)


def _check_size(images: Tensor) -> None:
    """Refuse images that reflection cannot extend by the window's radius."""
    height, width = images.shape[-2:]
    if min(height, width) <= RADIUS:
        expected = f"SSIM needs images of at least {RADIUS + 1} x {RADIUS + 1} pixels"
        raise InputError(expected, got=f"{height} x {width}", remedy="use larger crops")


def _planes(images: Tensor) -> Tensor:
    """The planes of all images, [P, H, W]."""
    return images.reshape(-1, *images.shape[-2:])
