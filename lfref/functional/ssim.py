"""Structural similarity of images, computed through 1 - SSIM without cancellation.

Letters: `x y` prediction and target, `d = x - y` and `s = x + y`; `mu` and `var` are their local Gaussian mean and
variance, `P` a plane (one channel of one image). With the constants of Wang et al. (2004),

    1 - SSIM = a + b - ab,    a = mu_d^2 / (mu_x^2 + mu_y^2 + C1),    b = var_d / ((var_s + var_d) / 2 + C2),

which holds the digits that 1 minus a number near 1 loses. Window and borders are those of torchmetrics
(Gaussian 11 x 11, sigma 1.5, K1 = .01, K2 = .03, reflection, mean over every pixel). Bright planes lose nothing in
float32; a plane whose own contrast is hundreds of times the data range does, and wants float64.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from lfref.errors import InputError
from lfref.functional.psnr import check_data_range, image_pair

RADIUS = 5
"""Pixels that the window reaches to each side; reflection needs images one pixel larger."""
SIGMA = 1.5
K1, K2 = 0.01, 0.03
# Larger pieces pass the 32 MiB above which glibc maps fresh pages for every tensor: 3 times slower on the CPU.
_PIXELS_AT_ONCE = 2**20


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
        parts = [_plane_values(*pair, *constants) for pair in zip(_portions(x), _portions(y), strict=True)]
    return torch.cat(parts).reshape(x.shape[:-2]).mean(-1)


def _check_size(images: Tensor) -> None:
    """Refuse images that reflection cannot extend by the window's radius."""
    height, width = images.shape[-2:]
    if min(height, width) <= RADIUS:
        expected = f"SSIM needs images of at least {RADIUS + 1} x {RADIUS + 1} pixels"
        raise InputError(expected, got=f"{height} x {width}", remedy="use larger crops")


def _portions(images: Tensor) -> tuple[Tensor, ...]:
    """The planes [P, H, W] of all images, as many at once as `_PIXELS_AT_ONCE` allows."""
    height, width = images.shape[-2:]
    return images.reshape(-1, height, width).split(max(1, _PIXELS_AT_ONCE // (height * width)))


def _plane_values(x: Tensor, y: Tensor, C1: float, C2: float) -> Tensor:
    """1 - SSIM of each plane, [P, H, W] twice -> [P]."""
    (mu_d, mu_s), (var_d, var_s) = _local_statistics(x, y)
    # mu_x^2 + mu_y^2 = (mu_s^2 + mu_d^2) / 2; numerators and denominators carry a factor of 2.
    squared = mu_d.square()
    a = 2 * squared / (mu_s.square() + squared + 2 * C1)
    b = 2 * var_d / (var_s + var_d + 2 * C2)
    return torch.addcmul(a + b, a, b, value=-1).mean((-2, -1))


def _local_statistics(x: Tensor, y: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Local means and variances of x - y and x + y, each [P, H, W]: ((mu_d, mu_s), (var_d, var_s)).

    Each is centred by its plane's mean first, or the squares of a bright plane would swamp its variance. The result
    does not depend on what was subtracted, so no gradient need flow through it.
    """
    d = x - y
    centre_x, centre_y, centre_d = (_plane_mean(planes) for planes in (x, y, d))
    mean, square = _window_means(torch.cat((d - centre_d, (x - centre_x) + (y - centre_y))))
    variance = (square - mean.square()).clamp(min=0)
    mu_d, mu_s = mean.chunk(2)
    return (mu_d + centre_d, mu_s + (centre_x + centre_y)), variance.chunk(2)


def _plane_mean(planes: Tensor) -> Tensor:
    """Mean of each plane, cut from the graph, [P, H, W] -> [P, 1, 1]."""
    return planes.detach().mean((-2, -1), keepdim=True)


def _window_means(planes: Tensor) -> tuple[Tensor, ...]:
    """Gaussian local means of the planes and of their squares, [P, H, W] -> two of [P, H, W]."""
    padded = F.pad(planes, (RADIUS,) * 4, mode="reflect")
    # Planes as channels of one image: a depthwise convolution is the fastest here, and CUDA never runs it in TF32.
    stacked = torch.cat((padded, padded.square()))[None]
    n_planes, window = stacked.shape[1], _window(stacked)
    rows = F.conv2d(stacked, window.expand(n_planes, 1, 1, -1), groups=n_planes)
    both = F.conv2d(rows, window[:, None].expand(n_planes, 1, -1, 1), groups=n_planes)
    return both[0].chunk(2)


def _window(like: Tensor) -> Tensor:
    """Normalised Gaussian weights of one axis, in the type and on the device of `like`, [11]."""
    offsets = torch.arange(-RADIUS, RADIUS + 1, dtype=torch.float64, device=like.device)
    weights = (-offsets.square() / (2 * SIGMA**2)).exp()
    return (weights / weights.sum()).to(like.dtype)
