"""Reference values, in forms whose steps are all well conditioned, and textbook formulas as they are in wide use.

Reference forms get float64 and share no code with the package: local means are products with banded matrices, views are
read by a matrix of the interpolation's kernel. Textbook forms compute in the type of their input; on benign input in
float32, each is as accurate as its definition allows.
Letters: `x y` prediction and target, [B, C, H, W]; `d` distance in pixels, `s` slope, `m` mean squared error, `v u`
view row and column.
"""

import functools
import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from lfref import geometry
from lfref.functional.psnr import CEILING_DB
from lfref.losses.composite import paper_weights

# Losses and metrics, [B].

C1, C2 = 0.01**2, 0.03**2
RADIUS, SIGMA = 5, 1.5
FLOOR, JOIN = 1e-10, math.exp(-2)
"""Least and largest mean squared error at which 1 / PSNR is the paper's: 100 and 8.69 dB."""
_K = math.log(10) / 10


def mse(x: Tensor, y: Tensor) -> Tensor:
    """Mean squared error, in the type of the images; the textbook form too."""
    return (x - y).square().mean((-3, -2, -1))


def l1(x: Tensor, y: Tensor) -> Tensor:
    """Mean absolute error, likewise."""
    return (x - y).abs().mean((-3, -2, -1))


def psnr(x: Tensor, y: Tensor) -> Tensor:
    """PSNR in dB, at most 100."""
    return -10 * mse(x, y).clamp(min=FLOOR).log10()


def textbook_psnr(x: Tensor, y: Tensor) -> Tensor:
    """Torchmetrics' PSNR, capped as ours is, so that identical images have a value."""
    values = [peak_signal_noise_ratio(a, b, data_range=1.0) for a, b in zip(x, y, strict=True)]
    return torch.stack(values).clamp(max=CEILING_DB)


def inverse_psnr(x: Tensor, y: Tensor) -> Tensor:
    """1 / PSNR between 100 and 8.69 dB, and its tangents beyond them."""
    m = mse(x, y)
    low, high = (-_K / math.log(end) + _K / (end * math.log(end) ** 2) * (m - end) for end in (FLOOR, JOIN))
    return torch.where(m < FLOOR, low, torch.where(m > JOIN, high, -_K / m.clamp(FLOOR, JOIN).log()))


def textbook_inverse_psnr(x: Tensor, y: Tensor) -> Tensor:
    """The paper's psi_2."""
    return 1 / (-10 * torch.log10(mse(x, y)))


def one_minus_ssim(x: Tensor, y: Tensor) -> Tensor:
    """1 - SSIM.

    With d = x - y and s = x + y, 1 - SSIM = a + b - ab, where a compares the means and b the variances of d and s: no
    two nearly equal numbers are subtracted.
    """
    d, s = x - y, (x - _mean(x)) + (y - _mean(y))
    (mu_d, var_d), (mu_s, var_s) = _local(d), _local(s)
    mu_s = mu_s + _mean(x) + _mean(y)
    a = 2 * mu_d.square() / (mu_s.square() + mu_d.square() + 2 * C1)
    b = 2 * var_d / (var_s + var_d + 2 * C2)
    return (a + b - a * b).mean((-3, -2, -1))


def textbook_one_minus_ssim(x: Tensor, y: Tensor) -> Tensor:
    """1 - torchmetrics' SSIM."""
    values = structural_similarity_index_measure(x, y, data_range=1.0, reduction="none")
    assert isinstance(values, Tensor)
    return 1 - values.reshape(-1)


def composite(x: Tensor, y: Tensor) -> Tensor:
    """The paper's loss of the reference forms."""
    return _weighted(mse(x, y), l1(x, y), one_minus_ssim(x, y), inverse_psnr(x, y))


def textbook_composite(x: Tensor, y: Tensor) -> Tensor:
    """The paper's loss of the textbook forms."""
    return _weighted(mse(x, y), l1(x, y), textbook_one_minus_ssim(x, y), textbook_inverse_psnr(x, y))


def _weighted(*terms: Tensor) -> Tensor:
    weights = paper_weights()
    names = ("mse", "l1", "ssim", "inverse_psnr")
    return torch.stack([weights[name] * term for name, term in zip(names, terms, strict=True)]).sum(0)


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


# Operators: views [V, U, C, H, W], slopes [N], weights [V, U] -> stack [N, C, H, W].

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

    Views of weight 0 are skipped, so they may hold NaN. The interpolation is a key of `KERNELS`, or `exact` (periodic
    only). The border is `wrap`, `edge`, or `renormalize`, which counts only views with a sample.
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


def grid_sample(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Textbook shift-and-sum: `grid_sample` with repeated edges, in the type of the views."""
    share, (n_channels, height, width) = weights.to(views.dtype) / weights.to(views.dtype).sum(), views.shape[2:]
    planes = []
    for slope in slopes.tolist():
        plane = torch.zeros_like(views[0, 0])
        for v, y in enumerate(geometry.angular_offsets(share.shape[0]).tolist()):
            for u, x in enumerate(geometry.angular_offsets(share.shape[1]).tolist()):
                move = torch.tensor([[1, 0, 2 * slope * x / (width - 1)], [0, 1, 2 * slope * y / (height - 1)]])
                grid = F.affine_grid(move[None], [1, n_channels, height, width], align_corners=True).to(views.dtype)
                plane += share[v, u] * F.grid_sample(views[v, u, None], grid, "bilinear", "border", True)[0]
        planes.append(plane)
    return torch.stack(planes)


def phase_ramps(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Textbook Fourier shifts: phases in float32, and no rule for the Nyquist bin."""
    share, size = weights.to(views.dtype) / weights.to(views.dtype).sum(), views.shape[-2:]
    spectra = torch.fft.rfft2(views * share[:, :, None, None, None])
    ky, kx = torch.fft.fftfreq(size[0])[:, None], torch.fft.rfftfreq(size[1])
    v, u = (geometry.angular_offsets(n).float() for n in share.shape)
    crossing = v[:, None, None, None] * ky + u[:, None, None] * kx
    ramps = [torch.exp(2j * torch.pi * float(slope) * crossing)[:, :, None] for slope in slopes]
    return torch.stack([torch.fft.irfft2((spectra * ramp).sum((0, 1)), s=size) for ramp in ramps])
