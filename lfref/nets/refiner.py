"""The refiner: a small residual network that corrects refocused planes, each by itself.

The correction is a mixture of candidates, which are the first features: differences between other pictures of the same
plane and the picture that is corrected, in units of the error scale. So nothing changes where the error scale is 0,
nothing can be invented, and all colours are treated alike. The last convolution starts at zero: an untrained refiner
changes nothing. The refiner works on a coarser grid of pixels with more channels, which reaches farther at the same
cost; pixel unshuffle and the convolution after it are one convolution with strides.
Letters: `N` planes, `K` channels of features, `C H W` channel, pixel row and column, `r` pixels along the side of a
coarse pixel.
Sources: Shi et al., "Real-Time Single Image and Video Super-Resolution Using an Efficient Sub-Pixel Convolutional
Neural Network", 2016 (the grid); Lim et al., "Enhanced Deep Residual Networks", 2017 (the blocks); Bako et al.,
"Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings", 2017 (the mixture).
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.errors import InputError, chosen
from lfref.nets import blocks
from lfref.nets.blocks import ACTIVATIONS

STEP = 0.2
"""Scale of the gate: with it, learning rates that suit the inner convolutions suit the last one too."""


class RefinerBlock(nn.Module):
    """Two convolutions whose result is added to their input, [B, width, H, W]."""

    def __init__(self, width: int, kernel: int, activation: Callable[[], nn.Module]) -> None:
        super().__init__()
        first, last = (nn.Conv2d(width, width, kernel, padding=kernel // 2) for _ in range(2))
        self.body = nn.Sequential(first, activation(), last)

    def forward(self, features: Tensor) -> Tensor:
        """Apply the block."""
        return features + self.body(features)


class Refiner(nn.Module):
    """Features, pictures and error scale -> better pictures; arguments are those of `conf/net/refiner.yaml`.

    Example:
        >>> features, pictures, error_scale = torch.rand(2, 11, 16, 17).split([7, 3, 1], dim=1)
        >>> Refiner(n_features=7, n_candidates=2, width=8)(features, pictures, error_scale).shape
        torch.Size([2, 3, 16, 17])
    """

    def __init__(
        self,
        n_features: int,
        n_candidates: int,
        channels: int = 3,
        width: int = 48,
        n_blocks: int = 4,
        shuffle: int = 2,
        kernel: int = 3,
        activation: str = "silu",
    ) -> None:
        self.config = {name: value for name, value in locals().items() if name not in ("self", "__class__")}
        super().__init__()
        sizes = n_candidates, channels, width, shuffle, kernel
        if min(sizes) < 1 or n_candidates * channels > n_features or kernel % 2 == 0:
            expected = "a refiner's sizes must be at least 1, its candidates among the features, its kernel odd"
            raise InputError(expected, got=self.config)
        make = chosen("activation", activation, ACTIVATIONS)
        self.n_features, self.n_candidates, self.shuffle = n_features, n_candidates, shuffle
        self.stem = nn.Conv2d(n_features, width, 3 * shuffle, stride=shuffle, padding=shuffle)
        self.blocks = nn.Sequential(*(RefinerBlock(width, kernel, make) for _ in range(n_blocks)))
        last = nn.Conv2d(width, (n_candidates + 1) * shuffle**2, 3, padding=1)
        for parameter in last.parameters():
            nn.init.zeros_(parameter)
        self.head = nn.Sequential(make(), last)
        # Convolutions on CPUs and tensor cores read this order fastest; feature maps follow the weights.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, features: Tensor, pictures: Tensor, error_scale: Tensor) -> Tensor:
        """Correct pictures [..., N, C, H, W] by features [..., N, K, H, W], candidates first, and their error scale
        [..., N, 1, H, W], the light by which candidates are multiplied.
        """
        height, width = features.shape[-2:]
        planes = features.flatten(0, -4) if features.ndim > 3 else features[None]
        inner = self.blocks(self.stem(blocks.padded(planes, self.shuffle)))
        output = F.pixel_shuffle(self.head(inner), self.shuffle)[..., :height, :width]
        *shares, gate = output.split(1, 1)
        candidates = planes.split(pictures.shape[-3], 1)[: self.n_candidates]
        mixed = shares[0] * candidates[0]
        for share, candidate in zip(shares[1:], candidates[1:], strict=True):
            mixed = torch.addcmul(mixed, share, candidate)
        # A gate of exactly 0 leaves a picture as it is; without a gate, all shares would have to be 0.
        opening = STEP * F.hardsigmoid(gate).reshape(error_scale.shape).to(error_scale) * error_scale
        return torch.addcmul(pictures, opening, mixed.reshape(pictures.shape).to(pictures))
