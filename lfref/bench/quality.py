"""How good refocused pictures are, plane by plane: in numbers, to the eye, in brightness; the interior and the whole.

Letters: `N` planes, `C H W` channel, pixel row and column.
"""

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from lfref.errors import InputError
from lfref.functional.colour import colour_difference
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim

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
