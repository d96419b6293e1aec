"""The loss of refiners: the share of each picture's error that remains after the correction.

Errors of scenes differ by a factor of a thousand. Relative to the error before, each picture counts alike, and PSNR
averages the logarithm. Only pixels with an error scale above 0 count, since no other may be corrected.
Letters: `C H W` channel, pixel row and column.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from lfref.errors import chosen

LEAST = 1e-5
"""Error in light that is added before dividing: 100 dB, beyond which pictures need not improve."""

POWERS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "l1": lambda error, share: (share * error.abs()).sum((-3, -2, -1)),
    "l2": lambda error, share: ((share * error.square()).sum((-3, -2, -1)) + 1e-12).sqrt(),
}
"""(error, share of each sample in the mean) -> error of each picture: [..., C, H, W] twice -> [...]."""

MEANS: dict[str, Callable[[Tensor], Tensor]] = {
    "ratio": torch.mean,
    "log": lambda left: left.log().mean(),
}
"""Mean over the pictures of the shares that remain."""


class RelativeError(nn.Module):
    """Refined pictures, truth, pictures and error scale -> share of the error that remains.

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

    def forward(self, refined: Tensor, truth: Tensor, pictures: Tensor, error_scale: Tensor) -> Tensor:
        """The share that remains, a scalar; images [..., C, H, W], the error scale [..., 1, H, W]."""
        counts = (error_scale > 0).to(truth).expand_as(truth)
        share = counts / counts.sum((-3, -2, -1), keepdim=True).clamp(min=1)
        after, before = (self.power(images - truth, share) + LEAST for images in (refined, pictures))
        return self.mean(after / before)
