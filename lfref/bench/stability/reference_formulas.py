"""Reference values: losses, metrics and refocused stacks in float64, in forms whose steps are all well conditioned.

They share no code with the package: local means are products with banded matrices, views are read by a matrix of the
interpolation's kernel, and the continuation of 1 / PSNR is written out piece by piece.
Letters: `x y` prediction and target, [..., C, H, W]; `d` distance in pixels, `s` slope, `m` mean squared error.
"""

import functools
import math
from collections.abc import Callable

import torch
from torch import Tensor

from lfref.losses.composite import paper_weights

C1, C2 = 0.01**2, 0.03**2
RADIUS, SIGMA = 5, 1.5
FLOOR, JOIN = 1e-10, math.exp(-2)
"""Least and largest mean squared error at which 1 / PSNR is the paper's: 100 and 8.69 dB."""
_K = math.log(10) / 10


def mse(x: Tensor, y: Tensor) -> Tensor:
    """Mean squared error of each image, [...]."""
    return (x - y).square().mean((-3, -2, -1))


def l1(x: Tensor, y: Tensor) -> Tensor:
    """Mean absolute error of each image, [...]."""
    return (x - y).abs().mean((-3, -2, -1))


def psnr(x: Tensor, y: Tensor) -> Tensor:
    """PSNR in dB, at most 100, [...]."""
    return -10 * mse(x, y).clamp(min=FLOOR).log10()


def inverse_psnr(x: Tensor, y: Tensor) -> Tensor:
    """1 / PSNR between 100 and 8.69 dB, and its tangents beyond them, [...]."""
    m = mse(x, y)
    low, high = (-_K / math.log(end) + _K / (end * math.log(end) ** 2) * (m - end) for end in (FLOOR, JOIN))
    return torch.where(m < FLOOR, low, torch.where(m > JOIN, high, -_K / m.clamp(FLOOR, JOIN).log()))


def one_minus_ssim(x: Tensor, y: Tensor) -> Tensor:
    """1 - SSIM of each image, [...].

    With d = x - y and s = x + y, 1 - SSIM = a + b - ab, where a compares the means and b the variances of d and s: no
    two nearly equal numbers are subtracted.
    """
    d, s = x - y, (x - _mean(x)) + (y - _mean(y))
    (mu_d, var_d), (mu_s, var_s) = _local(d), _local(s)
    mu_s = mu_s + _mean(x) + _mean(y)
    a = 2 * mu_d.square() / (mu_s.square() + mu_d.square() + 2 * C1)
    b = 2 * var_d / (var_s + var_d + 2 * C2)
    return (a + b - a * b).mean((-3, -2, -1))


def composite(x: Tensor, y: Tensor) -> Tensor:
    """The paper's loss, [...]."""
    weights, terms = paper_weights(), {"mse": mse, "l1": l1, "ssim": one_minus_ssim, "inverse_psnr": inverse_psnr}
    return torch.stack([weights[name] * term(x, y) for name, term in terms.items()]).sum(0)


def _mean(planes: Tensor) -> Tensor:
    return planes.mean((-2, -1), keepdim=True)


def _local(planes: Tensor) -> tuple[Tensor, Tensor]:
    """Local mean and variance, from values centred by the plane's mean."""
    centre = _mean(planes)  # E[x^2] - E[x]^2 loses all digits where the mean is far above the contrast
    rows, columns = (_window(length) for length in planes.shape[-2:])
    mean, square = (rows @ part @ columns.mT for part in (planes - centre, (planes - centre).square()))
    return mean + centre, (square - mean.square()).clamp(min=0)


@functools.cache
def _window(length: int) -> Tensor:
    """Gaussian local means along an axis that is reflected at its ends, [length, length]."""
    offsets = torch.arange(-RADIUS, RADIUS + 1)
    weights = (-offsets.double().square() / (2 * SIGMA**2)).softmax(0)
    index = torch.arange(-RADIUS, length + RADIUS).unfold(0, len(weights), 1).abs()
    index = length - 1 - (length - 1 - index).abs()
    return torch.zeros(length, length, dtype=torch.float64).scatter_add_(1, index, weights.expand(length, -1))


Kernel = Callable[[Tensor], Tensor]
"""Weight of a sample at a distance in pixels."""


def _linear(d: Tensor) -> Tensor:
    return (1 - d.abs()).clamp(min=0)


def _cubic(d: Tensor) -> Tensor:
    d = d.abs()
    near, far = (1.5 * d - 2.5) * d * d + 1, ((-0.5 * d + 2.5) * d - 4) * d + 2
    return torch.where(d < 1, near, torch.where(d < 2, far, 0.0))


KERNELS: dict[str, Kernel] = {"nearest": _linear, "linear": _linear, "cubic": _cubic}


def refocused(
    views: Tensor, slopes: Tensor, weights: Tensor, interpolation: str = "exact", border: str = "wrap"
) -> Tensor:
    """The stack [N, C, H, W]: the weighted sum of `rows @ view @ columns^T`, divided by the weights that count.

    Views [V, U, C, H, W] are float64; those of weight 0 are skipped, so they may hold NaN. The interpolation is a key
    of `KERNELS`, or `exact` (periodic only). The border is `wrap`, `edge`, or `renormalize`, which counts only views
    with a sample.
    """
    share = weights / weights.max()  # so that sums of weights of 1e308 or 5e-324 neither overflow nor vanish
    return torch.stack([_plane(views, float(s), share / share.sum(), interpolation, border) for s in slopes])


def _plane(views: Tensor, slope: float, share: Tensor, interpolation: str, border: str) -> Tensor:
    total, covered = torch.zeros_like(views[0, 0]), torch.zeros_like(views[0, 0, 0])
    for v, u in share.nonzero().tolist():
        dy, dx = slope * (v - (share.shape[0] - 1) / 2), slope * (u - (share.shape[1] - 1) / 2)
        rows, has_row = _reading_matrix(dy, views.shape[-2], interpolation, border)
        columns, has_column = _reading_matrix(dx, views.shape[-1], interpolation, border)
        weight = share[v, u] * has_row[:, None] * has_column
        total, covered = total + weight * (rows @ views[v, u] @ columns.mT), covered + weight
    return torch.where(covered > 0, total / covered, 0.0)


def _reading_matrix(shift: float, length: int, interpolation: str, border: str) -> tuple[Tensor, Tensor]:
    """The matrix that reads a shifted axis, [length, length], and 1 where the axis has a sample, else 0, [length]."""
    x = torch.arange(length, dtype=torch.float64)
    if interpolation == "exact":
        return _dirichlet(x[:, None] + shift - x, length), torch.ones_like(x)
    shift = math.floor(shift + 0.5) if interpolation == "nearest" else shift
    reach = math.ceil(abs(shift)) + 3
    samples = torch.arange(-reach, length + reach)
    index = samples % length if border == "wrap" else samples.clamp(0, length - 1)
    weights = KERNELS[interpolation](x[:, None] + shift - samples)
    matrix = torch.zeros(length, length, dtype=torch.float64).index_add_(1, index, weights)
    is_on_view = (x + shift >= 0) & (x + shift <= length - 1)
    return matrix, (is_on_view | (border != "renormalize")).double()


def _dirichlet(d: Tensor, length: int) -> Tensor:
    """Weights of trigonometric interpolation at distances d; even sizes use the real part of the Nyquist bin."""
    d = d - length * (d / length).round()
    at_nyquist = (math.pi * d / length).cos() if length % 2 == 0 else 1.0
    return torch.sinc(d) / torch.sinc(d / length) * at_nyquist
