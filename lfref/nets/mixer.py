"""The mixer: a small network that mixes pictures of a plane, each plane by itself.

It reads guides, which say how sharp, how reliable and how far from focus the pictures are, and predicts the share of
each candidate at each pixel: `better = picture + sum_k share_k (candidate_k - picture)`. Shares are the same for all
colours, so nothing can be invented. The last convolution starts at zero: an untrained mixer changes nothing. Unlike the
refiner it reads one grey guide for each candidate, and its first convolution is no larger than two coarse pixels: fewer
products for each pixel.
Letters: `N` planes, `K` channels of guides, `k` candidates, `C H W` channel, pixel row and column, `r` pixels along the
side of a coarse pixel.
Source: Bako et al., "Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings", 2017.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.errors import InputError, chosen
from lfref.nets import blocks
from lfref.nets.blocks import ACTIVATIONS
from lfref.nets.refiner import Corrector, RefinerBlock

STEP = 0.2
"""Scale of the shares: with it, learning rates that suit the inner convolutions suit the last one too."""
LEAST_ERROR = 5e-6
"""Error scale below which corrections fade out, in light."""


class Mixer(Corrector):
    """Guides and candidates -> better pictures.

    Args:
        n_guides: Channels of guides, K.
        n_candidates: Number of candidates, k.
        channels: Channels of the pictures, C.
        width: Channels of the blocks.
        n_blocks: Pairs of convolutions.
        shuffle: Pixels along the side of a coarse pixel, r, even.
        kernel: Side of the convolutions, odd.
        activation: A key of `ACTIVATIONS`.

    Example:
        >>> guides, pictures, differences = torch.rand(2, 4, 16, 17), torch.rand(2, 3, 16, 17), torch.rand(2, 6, 16, 17)
        >>> Mixer(n_guides=4, n_candidates=2, width=8).mixed(guides, pictures, differences).shape
        torch.Size([2, 3, 16, 17])
    """

    def __init__(
        self,
        n_guides: int,
        n_candidates: int,
        channels: int = 3,
        width: int = 48,
        n_blocks: int = 3,
        shuffle: int = 4,
        kernel: int = 3,
        activation: str = "silu",
    ) -> None:
        super().__init__()
        self.config = {
            "n_guides": n_guides,
            "n_candidates": n_candidates,
            "channels": channels,
            "width": width,
            "n_blocks": n_blocks,
            "shuffle": shuffle,
            "kernel": kernel,
            "activation": activation,
        }
        sizes = (n_guides, n_candidates, channels, width, shuffle, kernel)
        if min(sizes) < 1 or n_blocks < 0 or kernel % 2 == 0 or shuffle % 2:
            expected = "a mixer's sizes must be at least 1, n_blocks at least 0, its kernel odd, its shuffle even"
            raise InputError(expected, got=self.config)
        make = chosen("activation", activation, ACTIVATIONS)
        self.n_candidates = n_candidates
        self.shuffle = shuffle
        self.stem = nn.Conv2d(n_guides, width, 2 * shuffle, stride=shuffle, padding=shuffle // 2)
        self.blocks = nn.Sequential(*(RefinerBlock(width, kernel, make) for _ in range(n_blocks)))
        last = nn.Conv2d(width, n_candidates * shuffle**2, 3, padding=1)
        for parameter in last.parameters():
            nn.init.zeros_(parameter)
        self.head = nn.Sequential(make(), last)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def n_features(self) -> int:
        """As in `Corrector`: differences of all candidates, and guides."""
        return self.n_candidates * int(self.config["channels"]) + int(self.config["n_guides"])

    def forward(self, features: Tensor, pictures: Tensor, error_scale: Tensor) -> Tensor:
        """As in `Corrector`; features are the differences of `mixed`, and guides. Where the error scale is 0, pictures
        stay.

        Raises:
            InputError: Features have another number of channels.
        """
        if features.shape[-3] != self.n_features:
            raise InputError(f"this mixer reads {self.n_features} channels of features", got=features.shape[-3])
        planes = features.flatten(0, -4) if features.ndim > 3 else features[None]
        n_guides = int(self.config["n_guides"])
        differences, guides = planes.split([self.n_features - n_guides, n_guides], 1)
        flat = pictures.reshape(planes.shape[0], *pictures.shape[-3:])
        # Continuous: in flat regions, rounding decides whether an error scale is exactly 0.
        opening = (error_scale / LEAST_ERROR).clamp(max=1).reshape(planes.shape[0], 1, *error_scale.shape[-2:])
        return (flat + opening * (self.mixed(guides, flat, differences) - flat)).reshape(pictures.shape)

    def shares(self, guides: Tensor) -> Tensor:
        """Share of each candidate at each pixel, [N, k, H, W], for guides [N, K, H, W]."""
        height, width = guides.shape[-2:]
        inner = self.blocks(self.stem(blocks.padded(guides, self.shuffle)))
        return STEP * F.pixel_shuffle(self.head(inner), self.shuffle)[..., :height, :width]

    def mixed(self, guides: Tensor, pictures: Tensor, differences: Tensor) -> Tensor:
        """Mix pictures.

        Args:
            guides: In the type of the weights, [N, K, H, W].
            pictures: Pictures to correct, in light, [N, C, H, W].
            differences: Candidates minus pictures, one candidate after the other, in light, [N, k C, H, W].
        """
        shares = self.shares(guides).to(pictures)
        for share, difference in zip(shares.split(1, 1), differences.split(pictures.shape[1], 1), strict=True):
            pictures = pictures + share * difference
        return pictures
