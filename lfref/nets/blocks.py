"""The residual block of RefNet and the leaf choices of its ablations: activations and normalisations.

Letters: `F` filters of a block, as in the paper's figure of the ResBlock.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.errors import InputError, chosen

ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {
    "softplus": nn.Softplus,
    "relu": nn.ReLU,
    "leaky_relu": nn.LeakyReLU,
    "gelu": nn.GELU,
    "silu": nn.SiLU,
    "elu": nn.ELU,
}

EPSILON = 1e-3
"""Added to each variance: TensorFlow's, in which the paper was made. PyTorch's 1e-5 lets 22 normalisations of a black
frame, which divide by nothing else, amplify a gradient beyond what float32 holds."""

NORMALIZATIONS: dict[str, Callable[[int], nn.Module]] = {
    "instance": lambda channels: nn.InstanceNorm2d(channels, EPSILON, affine=True),
    "batch": lambda channels: nn.BatchNorm2d(channels, EPSILON),
    "group": lambda channels: nn.GroupNorm(math.gcd(32, channels), channels, EPSILON),
    # Layer norm of a convolutional network: over all channels and pixels of one sample.
    "layer": lambda channels: nn.GroupNorm(1, channels, EPSILON),
    "none": lambda channels: nn.Identity(),
}


class BlockStyle(NamedTuple):
    """Widths of a block's first two convolutions as divisors of F."""

    first: int
    second: int


STYLES: dict[str, BlockStyle] = {
    "text": BlockStyle(1, 2),  # F, F/2, F: the paper's text
    "sibling": BlockStyle(2, 2),  # F/2, F/2, F: the authors' sister paper and the usual bottleneck
}


class ResBlock(nn.Module):
    """1x1, 3x3, 1x1 convolutions with a skip connection: [B, C, H, W] -> [B, F, H, W].

    Args:
        channels: Channels that come in.
        filters: F, channels that go out; even.
        activation: A key of `ACTIVATIONS`.
        normalization: A key of `NORMALIZATIONS`.
        style: A key of `STYLES`.
        kernel: Side of the second convolution, odd; the paper's is 3.
        dilation: Pixels from one of its samples to the next.

    Raises:
        InputError: F is odd or a key is unknown.
    """

    def __init__(
        self,
        channels: int,
        filters: int,
        activation: str = "softplus",
        normalization: str = "instance",
        style: str = "text",
        kernel: int = 3,
        dilation: int = 1,
    ) -> None:
        super().__init__()
        if filters < 2 or filters % 2:
            raise InputError("the width of a block must be even and at least 2", got=filters)
        act = chosen("activation", activation, ACTIVATIONS)
        norm = chosen("normalization", normalization, NORMALIZATIONS)
        shape = chosen("style", style, STYLES)
        first, second = filters // shape.first, filters // shape.second
        self.body = nn.Sequential(
            nn.Conv2d(channels, first, 1),
            act(),
            norm(first),
            nn.Conv2d(first, second, kernel, padding=dilation * (kernel // 2), dilation=dilation),
            act(),
            norm(second),
            nn.Conv2d(second, filters, 1),
        )
        self.skip = nn.Identity() if channels == filters else nn.Conv2d(channels, filters, 1)
        self.activation = act()

    def forward(self, features: Tensor) -> Tensor:
        """Apply the block.

        Args:
            features: [B, C, H, W].

        Returns:
            [B, F, H, W].
        """
        return self.activation(self.body(features) + self.skip(features))


# PART coarse
# Pictures of whole coarse pixels: what lies beyond the edge is as what lies at it.
#
# Letters: `H W` pixel row and column, `r` pixels along the side of a coarse one.


def whole(images: Tensor, side: int) -> Tensor:
    """Images whose rows and columns are filled up to whole coarse pixels.

    Args:
        images: [B, K, H, W].
        side: Pixels along the side of a coarse one, r.

    Returns:
        [B, K, r * ceil(H / r), r * ceil(W / r)].
    """
    if side == 1:
        return images
    # What is followed at one size is run at others.
    if torch.compiler.is_exporting() or torch.jit.is_tracing():
        return _repeated(_repeated(images, side, -1), side, -2)
    height, width = images.shape[-2:]
    beyond = (0, -width % side, 0, -height % side)
    if not any(beyond):
        return images
    # Autocast would make single precision of it.
    with torch.autocast(images.device.type, enabled=False):
        return F.pad(images, beyond, mode="replicate")


def _repeated(images: Tensor, side: int, axis: int) -> Tensor:
    """The same along one axis by operations that are alike for all lengths: as many more as may be needed, then cut."""
    length = images.shape[axis]
    last = images.narrow(axis, length - 1, 1)
    filled = torch.cat([images] + [last] * (side - 1), axis)
    return filled.narrow(axis, 0, (length + side - 1) // side * side)
