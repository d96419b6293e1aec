"""The loss of refiners: what is left of the error of each picture that they were given.

Pictures of scenes differ in error by a factor of a thousand. Relative to what it was, each counts alike, and the mean
of the logarithm is what PSNR is the mean of. Only pixels that may be corrected count: those with a doubt.
Letters: `C H W` channel, pixel row and column.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from lfref.errors import chosen

LEAST = 1e-5
"""Error below which nothing is gained, in light: beyond 100 dB."""

POWERS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "l1": lambda error, share: (share * error.abs()).sum((-3, -2, -1)),
    "l2": lambda error, share: ((share * error.square()).sum((-3, -2, -1)) + 1e-12).sqrt(),
}
"""Error of each picture, [..., C, H, W], from the share of each sample in its mean -> [...]."""

MEANS: dict[str, Callable[[Tensor], Tensor]] = {
    "ratio": torch.mean,
    "log": lambda left: left.log().mean(),
}
"""Mean over the pictures of what is left, a share of the error that was."""


class RelativeError(nn.Module):
    """Refined pictures, truth and pictures, [..., C, H, W], and doubts -> the share of their error that is left.

    Args:
        power: A key of `POWERS`.
        mean: A key of `MEANS`.

    Raises:
        InputError: An unknown key.

    Example:
        >>> pictures, truth = torch.rand(2, 3, 16, 16), torch.rand(2, 3, 16, 16)
        >>> RelativeError()(pictures, truth, pictures, torch.ones(2, 1, 16, 16))
        tensor(0.)
    """

    def __init__(self, power: str = "l2", mean: str = "log") -> None:
        super().__init__()
        self.power = chosen("power", power, POWERS)
        self.mean = chosen("mean", mean, MEANS)

    def forward(self, refined: Tensor, truth: Tensor, pictures: Tensor, doubts: Tensor) -> Tensor:
        """The share that is left.

        Args:
            refined: What the refiner made.
            truth: What it should be.
            pictures: What it was given.
            doubts: Pixels count where these are above 0, [..., 1, H, W].

        Returns:
            A scalar.
        """
        counts = (doubts > 0).to(truth).expand_as(truth)
        share = counts / counts.sum((-3, -2, -1), keepdim=True).clamp(min=1)
        left, was = (self.power(each - truth, share) + LEAST for each in (refined, pictures))
        return self.mean(left / was)
