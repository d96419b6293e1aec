"""Structural similarity (SSIM) of images, computed through 1 - SSIM without cancellation.

Letters: `x y` prediction and target, `d = x - y` and `s = x + y`; `mu` and `var` are their local Gaussian mean and
variance, `P` a plane (one channel of one image). With the constants of Wang et al. (2004),

    1 - SSIM = a + b - ab,    a = mu_d^2 / (mu_x^2 + mu_y^2 + C1),    b = var_d / ((var_s + var_d) / 2 + C2),

which keeps the digits that 1 minus a number near 1 loses. Window and borders are those of torchmetrics
(Gaussian 11 x 11, sigma 1.5, K1 = .01, K2 = .03, reflection, mean over every pixel). Everything is computed in float64
and rounded once, also under autocast: in a flat plane, the equal rounding errors of all pixels add up.

From top to bottom: the public functions; values and derivatives of planes for PyTorch (`plane_values`; `formula`
computes the same by PyTorch's own operations, for GPUs); the compiled loops, which work row by row so that intermediate
results stay in the caches.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from lfref.errors import InputError
from lfref.functional import loops
from lfref.functional.loops import compiled
from lfref.functional.psnr import check_data_range, image_pair

K1, K2 = 0.01, 0.03
RADIUS = 5
"""Pixels that the window reaches to each side."""
SIGMA = 1.5
TAPS = 2 * RADIUS + 1

Reals = NDArray[np.floating]


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
    """1 - SSIM, in [0, 2], accurate also where the images hardly differ: the training loss. Arguments as for `ssim`."""
    check_data_range(data_range)
    x, y = image_pair(prediction, target)
    height, width = x.shape[-2:]
    if min(height, width) <= RADIUS:  # reflection cannot extend the image by the window's radius
        expected = f"SSIM needs images of at least {RADIUS + 1} x {RADIUS + 1} pixels"
        raise InputError(expected, got=f"{height} x {width}", remedy="use larger crops")
    constants = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    with torch.autocast(x.device.type, enabled=False):
        values = plane_values(x.reshape(-1, height, width), y.reshape(-1, height, width), *constants)
    return values.reshape(x.shape[:-2]).mean(-1).to(x.dtype)


def plane_values(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
    """1 - SSIM of each plane of x and y [P, H, W] with stabilisers C1 and C2; float64, [P], differentiable once."""
    if x.device.type != "cpu":
        return formula(x, y, C1, C2)
    needs_gradient = [torch.is_grad_enabled() and planes.requires_grad for planes in (x, y)]
    values, *_ = _Values.apply(x, y, C1, C2, *needs_gradient)
    return values


def formula(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
    """`plane_values` by PyTorch's own operations."""
    x, y = x.double(), y.double()
    # Each plane is centred by its mean first, or the squares of a bright plane would swamp its variance. The result
    # does not depend on the subtracted mean, so no gradient needs to flow through it.
    centre_x, centre_y = (planes.detach().mean((-2, -1), keepdim=True) for planes in (x, y))
    centre_d, centre_s = centre_x - centre_y, centre_x + centre_y
    fields = torch.cat((x - y - centre_d, x + y - centre_s))
    padded = F.pad(fields, (RADIUS,) * 4, mode="reflect")
    # Planes as channels of one image: a depthwise convolution gives the local means of the fields and their squares.
    stacked = torch.cat((padded, padded.square()))[None]
    n_planes, weights = stacked.shape[1], torch.from_numpy(window()).to(stacked)
    rows = F.conv2d(stacked, weights.expand(n_planes, 1, 1, -1), groups=n_planes)
    mean, square = F.conv2d(rows, weights[:, None].expand(n_planes, 1, -1, 1), groups=n_planes)[0].chunk(2)
    var_d, var_s = (square - mean.square()).clamp(min=0).chunk(2)
    mean_d, mean_s = mean.chunk(2)
    mu_d, mu_s = mean_d + centre_d, mean_s + centre_s
    # mu_x^2 + mu_y^2 = (mu_s^2 + mu_d^2) / 2; numerators and denominators carry a factor of 2.
    squared = mu_d.square()
    a = 2 * squared / (mu_s.square() + squared + 2 * C1)
    b = 2 * var_d / (var_s + var_d + 2 * C2)
    return (a + b - a * b).mean((-2, -1))


@torch.library.custom_op("lfref::one_minus_ssim", mutates_args=(), device_types="cpu")
def _compiled(x: Tensor, y: Tensor, C1: float, C2: float, for_x: bool, for_y: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Values and gradients together: a separate backward pass would compute the values once more."""
    results = _empty_results(x, y, C1, C2, for_x, for_y)
    pair = [planes.contiguous().numpy() for planes in (x, y)]
    values, *gradients = (result.numpy() for result in results)
    mean, adjoint = (np.ascontiguousarray(weights.T) for weights in bands(x.shape[2]))
    tables = Tables(bands(x.shape[1]), mean, adjoint, C1, C2)
    centres = torch.stack([planes.mean((1, 2), dtype=torch.float64) for planes in (x, y)], 1).numpy()

    def work(first: int, last: int) -> None:
        x_part, y_part, *others = (array[first:last] for array in (*pair, centres, values, *gradients))
        set_values_and_gradients(x_part, y_part, tables, *others)

    # A thread computes whole planes, so the number of threads changes no digit. One more pays from 2^17 pixels on.
    n_threads = min(loops.worthwhile(x.numel(), 1 << 17), max(len(x), 1))
    loops.share(work, loops.bands(len(x), n_threads), n_threads)
    return results


@_compiled.register_fake
def _empty_results(
    x: Tensor, y: Tensor, C1: float, C2: float, for_x: bool, for_y: bool
) -> tuple[Tensor, Tensor, Tensor]:
    values, no_gradient = x.new_empty(len(x), dtype=torch.float64), (len(x), 0, 0)
    g_x, g_y = (x.new_empty(x.shape if needed else no_gradient) for needed in (for_x, for_y))
    return values, g_x, g_y


class _Values(torch.autograd.Function):
    """The compiled values, with the compiled gradient."""

    @staticmethod
    def forward(x: Tensor, y: Tensor, C1: float, C2: float, *needed: bool) -> tuple[Tensor, Tensor, Tensor]:
        values, g_x, g_y = _compiled(x, y, C1, C2, *needed)
        return values, g_x, g_y

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor, Tensor]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*output[1:])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, weights: Tensor | None, *_: None) -> Any:
        if weights is None:
            return (None,) * 6
        pairs = zip(ctx.saved_tensors, ctx.needs_input_grad, strict=False)
        shares = weights[:, None, None]
        return *(gradient * shares.to(gradient) if needed else None for gradient, needed in pairs), *(None,) * 4


# The compiled loops. A Gaussian mean with reflection, and its adjoint, are bands of 11 weights that depend on the
# place; one loop serves both. `q` is one of the four fields d, s, d^2, s^2, each centred by its plane's mean; `g` are
# derivatives of 1 - SSIM.


class Bands(NamedTuple):
    """Weights of the neighbours of each place on an axis of n pixels; beyond the ends they are 0."""

    mean: Reals
    """Weights of the local mean, [n, 11]."""
    adjoint: Reals
    """Weights of the adjoint of the local mean, [n, 11]."""


class Tables(NamedTuple):
    """Inputs of the loops besides the images."""

    rows: Bands
    """Weights down the columns, [H, 11]."""
    mean: Reals
    """Weights of the local mean along a row, tap by tap, [11, W]."""
    adjoint: Reals
    """Weights of the adjoint of the local mean along a row, tap by tap, [11, W]."""
    C1: float
    C2: float


class Workspace(NamedTuple):
    """Memory of one thread."""

    fields: Reals
    """A row of the four fields, with zeros beyond its ends, [4, 5 + W + 5]."""
    ring: Reals
    """The last 11 rows, each filtered along itself; a new row replaces the oldest row, [11, 4, W]."""
    row: Reals
    """A row filtered along both axes, [4, W]."""


def window() -> NDArray[np.float64]:
    """Normalised Gaussian weights of one axis, [11]."""
    weights = np.exp(-(np.arange(-RADIUS, RADIUS + 1.0) ** 2) / (2 * SIGMA**2))
    return weights / weights.sum()


@functools.lru_cache(maxsize=32)
def bands(n: int) -> Bands:
    """The weights of an axis of n pixels; n must exceed `RADIUS`."""
    places, mean = np.arange(n), np.zeros((n, n))
    for offset, weight in zip(range(-RADIUS, RADIUS + 1), window(), strict=True):
        mean[places, n - 1 - abs(n - 1 - abs(places + offset))] += weight
    padded = [np.pad(matrix, ((0, 0), (RADIUS, RADIUS))) for matrix in (mean, mean.T)]
    diagonals = [np.stack([matrix[i, i : i + TAPS] for i in range(n)]) for matrix in padded]
    return Bands(diagonals[0], diagonals[1])


@compiled
def set_values_and_gradients(
    x: Reals, y: Reals, tables: Tables, means_of_planes: Reals, values: Reals, g_x: Reals, g_y: Reals
) -> None:
    """Fill `values` with 1 - SSIM of each plane, and `g_x`, `g_y` [P, H, W] with gradients ([P, 0, 0]: not needed)."""
    _, height, width = x.shape
    has_gradients = g_x.size + g_y.size > 0
    means, slopes = _workspace(width), _workspace(width)
    for p in range(len(x)):
        centres, total = (means_of_planes[p, 0], means_of_planes[p, 1]), np.zeros(width)
        means.ring[:], slopes.ring[:] = 0, 0
        # Three rows are at work: row i enters, row `middle` has all its neighbours and is compared, and row `last` has
        # the derivatives of all its neighbours and gets its gradient.
        for i in range(height + 2 * RADIUS):
            middle, last = i - RADIUS, i - 2 * RADIUS
            if i < height:
                _center(x[p, i], y[p, i], centres, means.fields)
                _filter_row(means.fields, tables.mean, means.ring[i % TAPS])
            if 0 <= middle < height:
                _filter_columns(means.ring, tables.rows.mean[middle], middle, means.row)
                _add_values_and_set_slopes(means.row, tables, centres, total, slopes.fields[:, RADIUS:])
                if has_gradients:
                    _filter_row(slopes.fields, tables.adjoint, slopes.ring[middle % TAPS])
            if last >= 0 and has_gradients:
                _filter_columns(slopes.ring, tables.rows.adjoint[last], last, slopes.row)
                for sign, g in ((1, g_x), (-1, g_y)):
                    if g.size:
                        _combine(x[p, last], y[p, last], centres, slopes.row, sign, g[p, last])
        values[p] = total.sum() / (height * width)


@compiled
def _workspace(width: int) -> Workspace:
    return Workspace(np.zeros((4, width + 2 * RADIUS)), np.zeros((TAPS, 4, width)), np.empty((4, width)))


@compiled
def _center(x: Reals, y: Reals, centres: tuple[float, float], fields: Reals) -> None:
    """Write a row of d, s and their squares, with the means subtracted: a large mean would hide the variance."""
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
                # Rows beyond the ends have weight 0; their places in the ring hold other rows, or zeros.
                value += band[k] * ring[(i + k + TAPS - RADIUS) % TAPS, q, j]
            total[j] = value


@compiled
def _add_values_and_set_slopes(
    row: Reals, tables: Tables, centres: tuple[float, float], total: Reals, slopes: Reals
) -> None:
    """Add a + b - ab of a row to `total`; fill `slopes` [4, W] with derivatives of its mean by the four local means."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    share = 1 / (len(tables.rows.mean) * len(total))
    for j in range(len(total)):
        mean_d, mean_s = row[0, j], row[1, j]
        mu_d, mu_s = mean_d + centre_d, mean_s + centre_s
        raw_d, raw_s = row[2, j] - mean_d * mean_d, row[3, j] - mean_s * mean_s
        var_d, var_s = _positive(raw_d), _positive(raw_s)
        luminance, structure = mu_s * mu_s + mu_d * mu_d + 2 * tables.C1, var_s + var_d + 2 * tables.C2
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
    """The value, or 0 for a negative value; NaN stays NaN."""
    return 0.0 if value < 0 else value


@compiled
def _combine(x: Reals, y: Reals, centres: tuple[float, float], fields: Reals, sign: int, g: Reals) -> None:
    """Fill `g` with derivatives with respect to x (sign 1) or y (-1), from those of the four centred fields."""
    centre_d, centre_s = centres[0] - centres[1], centres[0] + centres[1]
    for j in range(len(g)):
        first, second = np.float64(x[j]), np.float64(y[j])
        g_d = fields[0, j] + 2 * (first - second - centre_d) * fields[2, j]
        g_s = fields[1, j] + 2 * (first + second - centre_s) * fields[3, j]
        g[j] = g_s + sign * g_d
