"""How good refocused pictures are, plane by plane: in numbers, to the eye, in brightness; the interior and the whole.

Letters: `N` planes, `C H W` channel, pixel row and column.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.functional.psnr import image_pair, psnr
from lfref.functional.ssim import ssim

# PART colour
# How different two colours look: linear sRGB -> CIELAB, and the CIE's colour difference of the year 2000.
#
# One unit is about the smallest difference that people see side by side. Letters as the CIE's: `L a b` lightness and
# the
# two opponent axes, `C` chroma, `h` hue in degrees. Sources: IEC 61966-2-1, 1999; Sharma, Wu, Dalal, "The CIEDE2000
# color-difference formula: implementation notes, supplementary test data, and mathematical observations", 2005.

SRGB_TO_XYZ = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))
_KNEE = (6 / 29) ** 3
"""Relative luminance below which the cube root is continued by a straight line."""
_FULL_TURN, _HALF_TURN = 360.0, 180.0


def colour_difference(prediction: Tensor, target: Tensor) -> Tensor:
    """Delta E 2000 of every pixel, as a screen would show both: what leaves [0, 1] is clipped.

    Args:
        prediction: Linear sRGB, [..., 3, H, W].
        target: Of the same shape.

    Returns:
        Differences, at least 0, [..., H, W].

    Raises:
        InputError: The images are not comparable, or not of three colours.

    Example:
        >>> colour_difference(torch.ones(3, 1, 1), torch.zeros(3, 1, 1))
        tensor([[100.]])
    """
    prediction, target = image_pair(prediction, target)
    if prediction.shape[-3] != 3:
        raise InputError("colours differ where there are three channels", got=f"{prediction.shape[-3]} channels")
    return delta_e_2000(lab(prediction.clamp(0, 1)), lab(target.clamp(0, 1)))


def lab(pictures: Tensor) -> Tensor:
    """CIELAB under the white of sRGB (D65).

    Args:
        pictures: Linear sRGB, [..., 3, H, W].

    Returns:
        L in [0, 100] of pictures in [0, 1], a and b, of the same shape.
    """
    matrix = pictures.new_tensor(SRGB_TO_XYZ)
    xyz = torch.einsum("ij,...jhw->...ihw", matrix / matrix.sum(1, keepdim=True), pictures)
    above = xyz.clamp(min=_KNEE) ** (1 / 3)
    x, y, z = torch.where(xyz > _KNEE, above, xyz * (29 / 6) ** 2 / 3 + 4 / 29).unbind(-3)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -3)


def delta_e_2000(first: Tensor, second: Tensor) -> Tensor:
    """Difference of colours in CIELAB, all parametric factors 1.

    Args:
        first: L, a, b, [..., 3, H, W].
        second: Of the same shape.

    Returns:
        Differences, at least 0, [..., H, W].
    """
    (L1, C1, h1), (L2, C2, h2) = _cylinders(first, second)
    L, C, h = (L1 + L2) / 2, (C1 + C2) / 2, _mean_hue(C1, h1, C2, h2)
    turned = torch.remainder(h2 - h1 + _HALF_TURN, _FULL_TURN) - _HALF_TURN
    hue = 2 * (C1 * C2).sqrt() * _sin(turned / 2)
    lightness = (L2 - L1) / (1 + 0.015 * (L - 50) ** 2 / (20 + (L - 50) ** 2).sqrt())
    chroma, hue = (C2 - C1) / (1 + 0.045 * C), hue / (1 + 0.015 * C * _hue_weight(h))
    return (lightness**2 + chroma**2 + hue**2 + _rotation(C, h) * chroma * hue).clamp(min=0).sqrt()


def _cylinders(*colours: Tensor) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Lightness, chroma and hue of two colours, whose a is stretched where both are near grey."""
    planes = [colour.unbind(-3) for colour in colours]
    mean = torch.stack([torch.hypot(a, b) for _, a, b in planes]).mean(0)
    stretch = 1.5 - 0.5 * _saturation(mean)
    return [(L, torch.hypot(a * stretch, b), _hue(a * stretch, b)) for L, a, b in planes]


def _hue(a: Tensor, b: Tensor) -> Tensor:
    return torch.remainder(torch.rad2deg(torch.atan2(b, a)), _FULL_TURN)


def _mean_hue(C1: Tensor, h1: Tensor, C2: Tensor, h2: Tensor) -> Tensor:
    """The hue midway on the shorter arc; where one colour is grey, that of the other."""
    total = h1 + h2
    across = torch.where(total < _FULL_TURN, total + _FULL_TURN, total - _FULL_TURN)
    mean = torch.where((h1 - h2).abs() <= _HALF_TURN, total, across) / 2
    return torch.where(C1 * C2 == 0, total, mean)


def _hue_weight(h: Tensor) -> Tensor:
    return 1 - 0.17 * _cos(h - 30) + 0.24 * _cos(2 * h) + 0.32 * _cos(3 * h + 6) - 0.20 * _cos(4 * h - 63)


def _rotation(C: Tensor, h: Tensor) -> Tensor:
    """How far chroma and hue count together, which they do for blues."""
    return -2 * _saturation(C) * _sin(60 * torch.exp(-(((h - 275) / 25) ** 2)))


def _saturation(C: Tensor) -> Tensor:
    """From 0 for greys to 1 for vivid colours."""
    # The seventh power of C / 25, so that float32 holds it.
    ratio = (C / 25) ** 7
    return (ratio / (ratio + 1)).sqrt()


def _sin(degrees: Tensor) -> Tensor:
    return torch.sin(degrees * (math.pi / 180))


def _cos(degrees: Tensor) -> Tensor:
    return torch.cos(degrees * (math.pi / 180))


MEASURES: dict[str, Callable[["Shown", "Shown"], Tensor]] = {
    "psnr_db": lambda stack, reference: psnr(stack.stack, reference.stack),
    "ssim": lambda stack, reference: ssim(stack.stack, reference.stack),
    "delta_e": lambda stack, reference: colour_difference(stack.linear, reference.linear).mean((-2, -1)),
    "brightness": lambda stack, reference: stack.stack.mean((-3, -2, -1)) / reference.stack.mean((-3, -2, -1)),
}
"""What a plane is judged by, by the name of the column, each (stack, reference) -> [N]: PSNR in dB, SSIM, mean Delta E
2000, and the mean of the picture over that of its reference."""
WHOLE = "whole_"
"""What columns of the whole frame begin with."""


class Shown(NamedTuple):
    """A stack as it is, and with its tone curve undone, from which colours are read."""

    stack: Tensor
    """[N, C, H, W]."""
    linear: Tensor
    """Likewise."""

    def inside(self, margin: int) -> "Shown":
        """The same without a border.

        Args:
            margin: Its width in pixels.
        """
        height, width = self.stack.shape[-2:]
        window = (..., slice(margin, height - margin), slice(margin, width - margin))
        return Shown(self.stack[window], self.linear[window])


def check_margin(margin: int, size: tuple[int, int]) -> None:
    """Refuse a border that leaves too little of a picture to be judged.

    Args:
        margin: Width of the border in pixels.
        size: Height and width of the picture.

    Raises:
        InputError: Less than 8 pixels are left.
    """
    if min(size) - 2 * margin < 8:
        expected = f"pictures without a border of {margin} pixels must be 8 or more high and wide"
        raise InputError(expected, got=f"pictures of {size[0]}x{size[1]}", remedy="set margin=0, or use larger ones")


def planes(stack: Shown, reference: Shown, margin: int) -> dict[str, list[float]]:
    """Every measure of every plane.

    Args:
        stack: What is judged.
        reference: What it is judged by, of the same shape.
        margin: Width in pixels of the border that the interior lacks.

    Returns:
        A list of N numbers under each key of `MEASURES`, and again under `WHOLE` and that key for the whole frame.
    """
    areas = {"": (stack.inside(margin), reference.inside(margin)), WHOLE: (stack, reference)}
    return {
        f"{area}{name}": measure(*pair).tolist() for area, pair in areas.items() for name, measure in MEASURES.items()
    }
