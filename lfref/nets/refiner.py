"""The refiner: a small residual network that corrects refocused planes, each by itself, by guides that come with it.

What it adds is mixed of offers, the first of the guides: other pictures of the same plane, less the one that is
corrected, in units of the doubt that comes with it. So nothing is corrected where there is no doubt, nothing can be
invented, and all colours are treated alike. It starts at nothing, since the last convolution does.
It works on a coarser grid of pixels with more channels (pixel unshuffle, and the convolution after it, are one
convolution with strides): as many weights a pixel reach farther and cost less.
Letters: `N` planes, `K` channels of guides, `M` offers, `C H W` channel, pixel row and column, `r` pixels along the
side of a coarse one.
Source of the grid: Shi et al., "Real-Time Single Image and Video Super-Resolution Using an Efficient Sub-Pixel
Convolutional Neural Network", 2016; of the blocks: Lim et al., "Enhanced Deep Residual Networks", 2017; of
mixtures: Bako et al., "Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings", 2017.
"""

import abc
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.errors import InputError, chosen
from lfref.nets import blocks
from lfref.nets.blocks import ACTIVATIONS

STEP = 0.2
"""Share that an output of 1 stands for: rates that suit the inner convolutions suit the last one then."""


class RefinerBlock(nn.Module):
    """Two convolutions whose result is added: [B, width, H, W] -> the same.

    Args:
        width: Channels.
        kernel: Side of the convolutions, odd.
        activation: Made between them.
    """

    def __init__(self, width: int, kernel: int, activation: Callable[[], nn.Module]) -> None:
        super().__init__()
        first, last = (nn.Conv2d(width, width, kernel, padding=kernel // 2) for _ in range(2))
        self.body = nn.Sequential(first, activation(), last)

    def forward(self, features: Tensor) -> Tensor:
        """Apply the block."""
        return features + self.body(features)


class Correction(nn.Module, abc.ABC):
    """Guides [..., N, K, H, W], pictures [..., N, C, H, W] and doubts [..., N, 1, H, W] -> better pictures."""

    config: dict[str, Any]
    """The arguments that build it again, in plain containers."""
    n_offers: int
    """How many guides are offers."""

    @property
    def like(self) -> Tensor:
        """A tensor of the type and on the device that it works in."""
        return next(self.parameters())


class Refiner(Correction):
    """Guides [..., N, K, H, W], pictures [..., N, C, H, W] and doubts [..., N, 1, H, W] -> better pictures.

    Args:
        n_guides: Channels of guides, K.
        n_offers: How many of them are offers, of as many channels as pictures each: the first ones.
        channels: Of pictures, C.
        width: Channels within.
        n_blocks: Pairs of convolutions.
        shuffle: Pixels along the side of a coarse one, r.
        kernel: Side of the convolutions, odd.
        activation: A key of `ACTIVATIONS`.

    Raises:
        InputError: An option that no network can be built from.

    Example:
        >>> guides, pictures, doubts = torch.rand(2, 11, 16, 17).split([7, 3, 1], dim=1)
        >>> Refiner(n_guides=7, n_offers=2, width=8)(guides, pictures, doubts).shape
        torch.Size([2, 3, 16, 17])
    """

    def __init__(
        self,
        n_guides: int,
        n_offers: int,
        channels: int = 3,
        width: int = 48,
        n_blocks: int = 4,
        shuffle: int = 2,
        kernel: int = 3,
        activation: str = "silu",
    ) -> None:
        super().__init__()
        if min(n_guides, n_offers, channels, width, shuffle, kernel) < 1 or n_blocks < 0 or kernel % 2 == 0:
            got = (n_guides, n_offers, channels, width, n_blocks, shuffle, kernel)
            raise InputError("a refiner's sizes must be at least 1, n_blocks 0, its kernel odd", got=got)
        if n_offers * channels > n_guides:
            raise InputError("n_offers of all channels must be among the n_guides", got=f"{n_offers} and {n_guides}")
        make = chosen("activation", activation, ACTIVATIONS)
        self.config = {
            "n_guides": n_guides,
            "n_offers": n_offers,
            "channels": channels,
            "width": width,
            "n_blocks": n_blocks,
            "shuffle": shuffle,
            "kernel": kernel,
            "activation": activation,
        }
        self.n_offers = n_offers
        self.shuffle = shuffle
        self.stem = nn.Conv2d(n_guides, width, 3 * shuffle, stride=shuffle, padding=shuffle)
        self.blocks = nn.Sequential(*(RefinerBlock(width, kernel, make) for _ in range(n_blocks)))
        self.head = nn.Sequential(make(), _silent(nn.Conv2d(width, (n_offers + 1) * shuffle**2, 3, padding=1)))
        # What convolutions on CPUs and on tensor cores read fastest; features follow the weights.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, guides: Tensor, pictures: Tensor, doubts: Tensor) -> Tensor:
        """Correct pictures.

        Args:
            guides: In the type of the weights, offers first, [..., N, K, H, W].
            pictures: What is corrected, [..., N, C, H, W]; any type.
            doubts: Light that offers are in units of, of the type of the pictures, [..., N, 1, H, W].

        Raises:
            InputError: Guides of another number of channels.
        """
        if guides.shape[-3] != self.config["n_guides"]:
            raise InputError(
                f"a refiner of {self.config['n_guides']} guides must be given as many", got=guides.shape[-3]
            )
        height, width = guides.shape[-2:]
        planes = guides.flatten(0, -4) if guides.ndim > 3 else guides[None]
        features = self.blocks(self.stem(blocks.whole(planes, self.shuffle)))
        made = F.pixel_shuffle(self.head(features), self.shuffle)[..., :height, :width]
        *shares, gate = made.split(1, 1)
        offers = planes.split(pictures.shape[-3], 1)[: self.n_offers]
        mixed = shares[0] * offers[0]
        for share, offer in zip(shares[1:], offers[1:], strict=True):
            mixed = torch.addcmul(mixed, share, offer)
        # To leave a picture as it is, one output closes, wholly, instead of each share meeting zero.
        opened = STEP * F.hardsigmoid(gate).reshape(doubts.shape).to(doubts) * doubts
        return torch.addcmul(pictures, opened, mixed.reshape(pictures.shape).to(pictures))


def _silent(layer: nn.Conv2d) -> nn.Conv2d:
    """The layer with weights that make nothing of anything."""
    with torch.no_grad():
        layer.weight.zero_()
        assert layer.bias is not None
        layer.bias.zero_()
    return layer
