"""Building blocks of networks: RefNet's residual block, its activations and normalisations, padding of coarse grids.

Letters: `F` filters of a block, as in the paper's figure of the ResBlock; `H W` pixel row and column.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from lfref.errors import chosen

ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {
    "softplus": nn.Softplus,
    "relu": nn.ReLU,
    "leaky_relu": nn.LeakyReLU,
    "gelu": nn.GELU,
    "silu": nn.SiLU,
    "elu": nn.ELU,
}

EPSILON = 1e-3
"""Number that is added to each variance: TensorFlow's default, which the paper used. With PyTorch's 1e-5 the 22
normalisations of a black frame, whose variance is 0, amplify a gradient beyond the range of float32."""


class InstanceNorm2d(nn.InstanceNorm2d):
    """Instance normalisation with its gradient made contiguous.

    PyTorch 2.13 on a CPU gives wrong gradients without notice for a batch of one whose channels lie last in memory:
    it normalises a contiguous copy of the images, and reads the gradient as if it lay likewise.
    """

    def forward(self, images: Tensor) -> Tensor:
        """Normalise."""
        result = super().forward(images)
        if result.requires_grad and not torch.compiler.is_compiling():
            result.register_hook(torch.Tensor.contiguous)
        return result


NORMALIZATIONS: dict[str, Callable[[int], nn.Module]] = {
    "instance": lambda channels: InstanceNorm2d(channels, EPSILON, affine=True),
    "batch": lambda channels: nn.BatchNorm2d(channels, EPSILON),
    "group": lambda channels: nn.GroupNorm(math.gcd(32, channels), channels, EPSILON),
    # Layer norm of a convolutional network: its mean is over all channels and pixels of one sample.
    "layer": lambda channels: nn.GroupNorm(1, channels, EPSILON),
    "none": lambda channels: nn.Identity(),
}


STYLES = {
    "text": (1, 2),  # F, F/2, F: the paper's text
    "sibling": (2, 2),  # F/2, F/2, F: the authors' sister paper and the usual bottleneck
}
"""Widths of a block's first two convolutions as divisors of F."""


def is_autocast(images: Tensor) -> bool:
    """Whether autocast is on for the device of these images; `meta`, where only shapes are computed, has none."""
    device = images.device.type
    return device != "meta" and torch.is_autocast_enabled(device)


class WideConv2d(nn.Conv2d):
    """A convolution that autocast leaves in the type of its weights."""

    def forward(self, images: Tensor) -> Tensor:
        """Apply the convolution."""
        if not is_autocast(images):
            return super().forward(images)
        with torch.autocast(images.device.type, enabled=False):
            return super().forward(images.to(self.weight.dtype))


class StemConv2d(nn.Conv2d):
    """The first convolution: its bias and result stay in the type of the bias under autocast.

    It reads colours apart by the same weights; channels are (view, colour, pixel of a coarse one, `inner` of them).
    """

    def __init__(self, samples: int, filters: int, kernel: int, colours: int = 1, inner: int = 1) -> None:
        super().__init__(samples // colours, filters // colours, kernel, padding=kernel // 2)
        self.colours, self.inner = colours, inner

    def forward(self, images: Tensor) -> Tensor:
        """Apply the convolution: [B, K, H, W] -> [B, F, H, W], filters in the order (filter, colour)."""
        if self.colours == 1:
            return self._convolved(images)
        result = self._convolved(apart_by_colour(images, self.colours, self.inner))
        return result.unflatten(0, (self.colours, -1)).movedim(0, 2).flatten(1, 2)

    def _convolved(self, images: Tensor) -> Tensor:
        if not is_autocast(images):
            return super().forward(images)
        assert self.bias is not None
        return self._conv_forward(images, self.weight, None).to(self.bias.dtype) + self.bias[:, None, None]


def apart_by_colour(images: Tensor, colours: int, inner: int) -> Tensor:
    """Images [B, A C R, H, W] with each colour as an image of its own, [C B, A R, H, W]; R = `inner`."""
    return images.unflatten(1, (-1, colours, inner)).movedim(2, 0).flatten(2, 3).flatten(0, 1)


class ResBlock(nn.Module):
    """1x1, 3x3, 1x1 convolutions with a skip connection: [B, C, H, W] -> [B, F, H, W]; options as for `RefNet`.

    Under autocast the sum with the skip stays in float32: at its values of 8 to 24, bfloat16 has steps of 1/8.
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
        act = chosen("activation", activation, ACTIVATIONS)
        norm = chosen("normalization", normalization, NORMALIZATIONS)
        first, second = (filters // divisor for divisor in chosen("style", style, STYLES))
        self.body = nn.Sequential(
            nn.Conv2d(channels, first, 1),
            act(),
            norm(first),
            nn.Conv2d(first, second, kernel, padding=dilation * (kernel // 2), dilation=dilation),
            act(),
            norm(second),
            nn.Conv2d(second, filters, 1),
        )
        self.skip = nn.Identity() if channels == filters else WideConv2d(channels, filters, 1)
        self.activation = act()

    def forward(self, features: Tensor) -> Tensor:
        """Apply the block."""
        return self.activation(self.body(features) + self.skip(features))


def places(length: int, count: int, device: torch.device) -> Tensor:
    """Places of the pixels of a row among `count`: those at its ends have one each, the others share the middle one."""
    steps, n = torch.arange(length, device=device), count // 2
    return steps.clamp(max=n) + (steps - (length - 1 - n)).clamp(min=0)


def by_place(values: Tensor, height: int, width: int) -> Tensor:
    """Values of each place along both axes, [K, P, P], as a map [K, height, width]."""
    rows, columns = (places(length, values.shape[-1], values.device) for length in (height, width))
    return values.index_select(1, rows).index_select(2, columns)


def sum_by_place(images: Tensor, count: int) -> Tensor:
    """Sums of images [B, K, H, W] over their pixels of each place, [K, P, P]; P = `count`."""
    rows, columns = (places(length, count, images.device) for length in images.shape[-2:])
    of_rows = images.new_zeros(len(rows), count).scatter_(1, rows[:, None], 1)
    of_columns = images.new_zeros(len(columns), count).scatter_(1, columns[:, None], 1)
    return torch.einsum("bkhw,hp,wq->kpq", images, of_rows, of_columns)


def padded(images: Tensor, side: int) -> Tensor:
    """Images [B, K, H, W] with the last row and column repeated until both are multiples of `side`."""
    if side == 1:
        return images
    # By index, not `F.pad`: the size is open in exported graphs, and autocast would convert to single precision.
    for axis in (-1, -2):
        length = images.shape[axis]
        inside = torch.arange((length + side - 1) // side * side, device=images.device).clamp(max=length - 1)
        images = images.index_select(axis, inside)
    return images
