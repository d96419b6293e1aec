"""Mean squared error, PSNR and the inverse PSNR of images, finite wherever they are evaluated.

Letters: `C H W` channel, pixel row, pixel column; `m` mean squared error over the squared data range.
Source: the paper's psi_2 = 1/PSNR, which is singular for identical images and at m = 1, and is continued here.
"""

import math

import torch
from torch import Tensor

from lfref.errors import InputError

CEILING_DB = 100.0
"""Largest PSNR that is returned, in dB; identical images have an infinite PSNR."""
MEAN_CAP_DB = 70.0
"""A PSNR counts in a mean by at most this much: errors below 1/3000 of white are seen by nobody, and a few planes that
are next to perfect would outweigh many that are not. Medians and worst cases are not capped."""
_FLOOR, _JOIN = 10 ** (-CEILING_DB / 10), math.exp(-2)
_K = math.log(10) / 10


def mse(prediction: Tensor, target: Tensor) -> Tensor:
    """Mean squared error of each image, [...], in float64, so that no float32 square under- or overflows."""
    prediction, target = image_pair(prediction, target)
    return (prediction.double() - target.double()).square().mean((-3, -2, -1))


def psnr(prediction: Tensor, target: Tensor, data_range: float = 1.0) -> Tensor:
    """Peak signal-to-noise ratio of each image, -10 log10(m), at most `CEILING_DB` = 100 dB.

    Args:
        prediction: Images, [..., C, H, W].
        target: Images of the same shape.
        data_range: Difference between white and black, finite and above 0.

    Returns:
        PSNR in dB, (-inf, 100], float32 or the images' wider type, [...]. The gradient is 0 at the ceiling.

    Raises:
        InputError: The images are not comparable, or data_range is not usable.

    Example:
        >>> psnr(torch.full((3, 8, 8), 0.6), torch.full((3, 8, 8), 0.5))
        tensor(20.0000)
    """
    m = _normalised_mse(prediction, target, data_range)
    return (-10 * m.clamp(min=_FLOOR).log10()).to(working_type(prediction, target))


def inverse_psnr(prediction: Tensor, target: Tensor, data_range: float = 1.0) -> Tensor:
    """1 / PSNR of each image in 1/dB, [...], the paper's psi_2, continued to where PSNR is infinite or not above 0."""
    m = _normalised_mse(prediction, target, data_range)
    return inverse_psnr_of_mse(m).to(working_type(prediction, target))


def inverse_psnr_of_mse(m: Tensor) -> Tensor:
    """1 / PSNR as a function of the normalised mean squared error: -K / ln m from 1e-10 to e^-2, K = ln(10)/10.

    Outside, the tangent at the nearer end continues it: once differentiable at 1e-10, twice at e^-2 (8.69 dB), where
    -K / ln m has its inflection. Positive and strictly increasing for every m >= 0; float64 keeps it exact.
    """
    # `relu`, not `where`: its gradient at 0 is 0, and only finite numbers are ever multiplied by 0.
    below, above = (_FLOOR - m).relu(), (m - _JOIN).relu()
    return -_K / m.clamp(_FLOOR, _JOIN).log() - _tangent(_FLOOR) * below + _tangent(_JOIN) * above


def _tangent(m: float) -> float:
    """Derivative of -K / ln m."""
    return _K / (m * math.log(m) ** 2)


def _normalised_mse(prediction: Tensor, target: Tensor, data_range: float) -> Tensor:
    """Mean squared error of each image over the squared data range, float64, [...]."""
    check_data_range(data_range)
    return mse(prediction, target) / data_range**2


def image_pair(prediction: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Both images in one type, float32 or wider; an InputError unless they are comparable."""
    is_real = prediction.is_floating_point() and target.is_floating_point()
    if prediction.shape != target.shape or prediction.ndim < 3 or prediction.numel() == 0 or not is_real:
        got = " and ".join(f"{list(images.shape)} of {images.dtype}" for images in (prediction, target))
        raise InputError("images must be [..., C, H, W], of one shape, not empty and floating point", got=got)
    common = working_type(prediction, target)
    return prediction.to(common), target.to(common)


def working_type(prediction: Tensor, target: Tensor) -> torch.dtype:
    """The type that both images fit in: float64 if one of them is, else float32."""
    return torch.promote_types(torch.promote_types(prediction.dtype, target.dtype), torch.float32)


def check_data_range(data_range: float) -> None:
    """Refuse a data range that is not finite or not above 0."""
    if not (math.isfinite(data_range) and data_range > 0):
        raise InputError("data_range must be finite and above 0", got=data_range, remedy="radiance in [0, 1] has 1.0")
