"""RefNet: one pass of a residual network from a light field to its whole refocused stack.

The paper leaves the widths F, the first kernel and the last kernels open (its figure is missing), so they are
options; the default schedule has the 12.5 million parameters that the paper states. Options beyond the paper make it
faster (a coarser grid of pixels with more channels) or extend its reach.
Letters: as in `Network`; `r` pixels along the side of a coarse pixel.
Sources: Hedayati, Havens, Bos, "Machine Learning Method for Light Field Refocusing", section 3.1; Shi et al.,
"Real-Time Single Image and Video Super-Resolution Using an Efficient Sub-Pixel Convolutional Neural Network", 2016
(the coarser grid).
"""

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.errors import InputError, counted
from lfref.lightfield import check_views
from lfref.nets import blocks, network
from lfref.nets.blocks import ResBlock
from lfref.nets.network import Network, Total, one_process

PAPER_WIDTHS = (512,) * 6 + (384,) + (256,) * 4


class RefNet(Network):
    """Views [..., V, U, C, H, W] -> stack [..., N, C, H, W], both in [0, 1]; the labels fix the planes.

    Args:
        n_planes: Planes of the stack, N.
        grid: View rows and columns (V, U).
        channels: Colour channels, C.
        activation: Activation of the blocks: softplus, relu, leaky_relu, gelu, silu or elu.
        normalization: Normalisation of the blocks: instance, batch, group, layer or none.
        widths: Filters F of each block.
        n_blocks: Number of blocks; the schedule of widths is stretched or thinned to it. None: one per width.
        style: `text` (F, F/2, F) or `sibling` (F/2, F/2, F).
        stem_width: Filters of the first convolution.
        stem_kernel: Kernel of the first convolution, odd.
        head_kernel: Kernel of the last two convolutions, odd.
        shuffle: Pixels along the side of a coarse pixel, r; 1 (the paper's) works on the pixels themselves.
        kernel: Side of the convolution in the middle of a block, odd.
        dilation: Distance between the samples of that convolution in (coarse) pixels.

    Raises:
        InputError: An option from which no network can be built.

    Example:
        >>> RefNet(n_planes=2, grid=(3, 3), widths=(8,), stem_width=8)(torch.rand(3, 3, 3, 16, 16)).shape
        torch.Size([2, 3, 16, 16])
    """

    name = "refnet"

    def __init__(
        self,
        n_planes: int = 16,
        grid: Sequence[int] = (7, 7),
        channels: int = 3,
        activation: str = "softplus",
        normalization: str = "instance",
        widths: Sequence[int] = PAPER_WIDTHS,
        n_blocks: int | None = None,
        style: str = "text",
        stem_width: int = 192,
        stem_kernel: int = 3,
        head_kernel: int = 1,
        shuffle: int = 1,
        kernel: int = 3,
        dilation: int = 1,
    ) -> None:
        super().__init__()
        schedule = stretched(widths, len(widths) if n_blocks is None else n_blocks)
        sizes, kernels = (n_planes, *grid, channels, stem_width, shuffle, dilation), (stem_kernel, head_kernel, kernel)
        if len(grid) != 2 or min(sizes) < 1:
            expected = "planes, grid, channels, stem width, shuffle and dilation must be positive"
            raise InputError(expected, got=sizes)
        if any(side < 1 or side % 2 == 0 for side in kernels):
            raise InputError("kernels must be odd, so that the picture keeps its size", got=list(kernels))
        self.config: dict[str, Any] = {
            "n_planes": n_planes,
            "grid": list(grid),
            "channels": channels,
            "activation": activation,
            "normalization": normalization,
            "widths": schedule,
            "style": style,
            "stem_width": stem_width,
            "stem_kernel": stem_kernel,
            "head_kernel": head_kernel,
            "shuffle": shuffle,
            "kernel": kernel,
            "dilation": dilation,
        }
        self.n_planes = n_planes
        self.grid = (grid[0], grid[1])
        self.shuffle = shuffle
        self.reach = dilation * (kernel // 2)
        outputs, samples = n_planes * channels * shuffle**2, grid[0] * grid[1] * channels * shuffle**2
        choices = (activation, normalization, style, kernel, dilation)
        self.trunk = nn.Sequential(
            nn.Conv2d(samples, stem_width, stem_kernel, padding=stem_kernel // 2),
            nn.ReLU(),
            *(ResBlock(a, b, *choices) for a, b in itertools.pairwise([stem_width, *schedule])),
            nn.Conv2d(schedule[-1], outputs, head_kernel, padding=head_kernel // 2),
            nn.ReLU(),
        )
        self.head = nn.Conv2d(outputs, outputs, head_kernel, padding=head_kernel // 2)

    def features(self, views: Tensor) -> Tensor:
        """Input of the last convolution: views [..., V, U, C, H, W] -> [B, N C r^2, H / r, W / r], rounded up.

        Raises:
            InputError: The views have another grid or number of channels than the network was built for, another type
                of sample, or too few pixels.
        """
        check_views(views)
        expected = (*self.config["grid"], self.config["channels"])
        if tuple(views.shape[-5:-2]) != expected:
            grid = f"[{expected[0]},{expected[1]}]"
            raise InputError(
                f"this network reads views [..., {', '.join(map(str, expected))}, H, W]",
                got=f"shape {list(views.shape)}",
                remedy=f"set reader.views={grid}, or scene.camera.grid={grid} for simulated scenes",
            )
        if max(views.shape[-2:]) <= self.shuffle:
            raise InputError(
                f"normalisation needs views of more than one pixel of {self.shuffle}x{self.shuffle}",
                got=f"{views.shape[-2]}x{views.shape[-1]}",
            )
        # Padding grows with the dilation: without a limit, a small file could ask for any amount of memory.
        if self.reach > max(views.shape[-2:]):
            raise InputError("blocks must reach no farther than the picture", got=f"{self.reach} pixels")
        working = self.head.weight.dtype
        if views.dtype != working and not torch.is_autocast_enabled(views.device.type):
            raise InputError(
                f"this network reads {working}", got=views.dtype, remedy="convert the views or the network"
            )
        return self.trunk(self._coarse(views.reshape(-1, expected[0] * expected[1] * expected[2], *views.shape[-2:])))

    def forward(self, views: Tensor, slopes: Tensor | None = None) -> Tensor:
        """Refocus as in `Network`; the planes are fixed: only the number of slopes is checked. The stack is >= 0."""
        if slopes is not None and len(slopes) != self.n_planes:
            raise InputError(
                f"this network makes {counted(self.config['n_planes'], 'plane')}", got=counted(len(slopes), "slope")
            )
        height, width = views.shape[-2:]
        images = F.pixel_shuffle(torch.relu(self.head(self.features(views))), self.shuffle)[..., :height, :width]
        return images.reshape(*views.shape[:-5], self.config["n_planes"], self.config["channels"], height, width)

    def prime(self, views: Tensor, slopes: Tensor | None, labels: Tensor, total: Total = one_process) -> None:
        """Scale the last convolution on a first batch: see `network.prime`."""
        with torch.no_grad():
            network.prime(self.head, self.features(views), self._coarse(labels.flatten(1, 2)), total=total)

    def _coarse(self, images: Tensor) -> Tensor:
        """Images [B, K, H, W] on the coarser grid, [B, K r^2, H / r, W / r], sizes rounded up."""
        return F.pixel_unshuffle(blocks.padded(images, self.shuffle), self.shuffle)


def stretched(widths: Sequence[int], n_blocks: int) -> list[int]:
    """A schedule of widths resampled to another number of blocks; each block takes the nearest original width.

    Raises:
        InputError: There is no width or no block.
    """
    if len(widths) == 0 or n_blocks < 1:
        raise InputError("RefNet needs at least one block and one width", got=f"{n_blocks} and {list(widths)}")
    return [int(widths[(2 * i + 1) * len(widths) // (2 * n_blocks)]) for i in range(n_blocks)]
