"""Structural similarity of images, computed through 1 - SSIM without cancellation.

Letters: `x y` prediction and target, `d = x - y` and `s = x + y`; `mu` and `var` are their local Gaussian mean and
variance, `P` a plane (one channel of one image). With the constants of Wang et al. (2004),

    1 - SSIM = a + b - ab,    a = mu_d^2 / (mu_x^2 + mu_y^2 + C1),    b = var_d / ((var_s + var_d) / 2 + C2),

which holds the digits that 1 minus a number near 1 loses. Window and borders are those of torchmetrics
(Gaussian 11 x 11, sigma 1.5, K1 = .01, K2 = .03, reflection, mean over every pixel). All of it is computed in float64
and rounded once, also under autocast: a flat plane adds up the same rounding in every pixel.
"""

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.functional.psnr import check_data_range, image_pair
from lfref.functional.ssim_kernel import RADIUS
from lfref.functional.ssim_planes import plane_values

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
