"""The loss of refiners: what is left of the error of each picture that they were given.

Pictures of scenes differ in error by a factor of a thousand. Relative to what it was, each counts alike, and the mean
of the logarithm is what PSNR is the mean of.
Letters: `C H W` channel, pixel row and column.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from lfref.errors import InputError, chosen

LEAST = 1e-4
"""Error below which nothing is gained, in light: beyond 80 dB."""

POWERS: dict[str, Callable[[Tensor], Tensor]] = {
    "l1": lambda error: error.abs().mean((-3, -2, -1)),
    "l2": lambda error: (error.square().mean((-3, -2, -1)) + 1e-12).sqrt(),
}
"""Error of each picture, [..., C, H, W] -> [...]."""

MEANS: dict[str, Callable[[Tensor], Tensor]] = {
    "ratio": torch.mean,
    "log": lambda left: left.log().mean(),
}
"""Mean over the pictures of what is left, a share of the error that was."""


class RelativeError(nn.Module):
    """Refined pictures, truth and pictures, [..., C, H, W] each -> the share of their error that is left, a scalar.

    Args:
        power: A key of `POWERS`.
        mean: A key of `MEANS`.
        border: Pixels at each edge that do not count: there pictures lack light that no network can know.

    Raises:
        InputError: An unknown key, or a border below 0.

    Example:
        >>> pictures, truth = torch.rand(2, 3, 16, 16), torch.rand(2, 3, 16, 16)
        >>> RelativeError()(pictures, truth, pictures)
        tensor(1.)
    """

    def __init__(self, power: str = "l1", mean: str = "ratio", border: int = 0) -> None:
        super().__init__()
        self.power = chosen("power", power, POWERS)
        self.mean = chosen("mean", mean, MEANS)
        if border < 0:
            raise InputError("border must be at least 0", got=border)
        self.border = border

    def forward(self, refined: Tensor, truth: Tensor, pictures: Tensor) -> Tensor:
        """The share that is left."""
        left, was = (self.power(self._inner(each - truth)) + LEAST for each in (refined, pictures))
        return self.mean(left / was)

    def _inner(self, error: Tensor) -> Tensor:
        height, width = error.shape[-2:]
        return error[..., self.border : height - self.border, self.border : width - self.border]
