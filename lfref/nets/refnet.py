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
import math
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.errors import InputError
from lfref.lightfield import check_views
from lfref.nets import blocks, initialization
from lfref.nets.blocks import ResBlock, StemConv2d, WideConv2d
from lfref.nets.initialization import Total, one_process
from lfref.nets.network import Network

PAPER_WIDTHS = (512,) * 6 + (384,) + (256,) * 4
INITIALIZATIONS = "linear", "random"
PADDINGS = "zeros", "renormalize"
STEM_PIXELS, HEAD_PIXELS = 1 << 14, 1 << 16
"""Pixels of crops from which the linear start computes stem and head, evenly drawn where there are more."""
START_BORDER = 4
"""Pixels at the border of a crop that the linear start leaves out: labels near focus lose views there."""


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
        stem_by_colour: Whether the first convolution reads each colour by itself, with the same weights: a third of the
            weights, of which a larger kernel sees farther at the same cost.
        head_kernel: Kernel of the last two convolutions, odd.
        shuffle: Pixels along the side of a coarse pixel, r; 1 (the paper's) works on the pixels themselves.
        kernel: Side of the convolution in the middle of a block, odd.
        dilation: Distance between the samples of that convolution in (coarse) pixels, for all blocks or for each; a
            list is stretched to the number of blocks, as the widths are.
        padding: Convolutions read zeros beyond the frame, while labels at its edge are means over fewer views.
            `renormalize` multiplies the output at the edge by gains, one for each channel and place; `zeros` (the
            paper's) leaves it as it is.
        initialization: `linear` (`lfref.nets.initialization`) or `random` (the paper's), once a training begins.

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
        stem_by_colour: bool = False,
        head_kernel: int = 1,
        shuffle: int = 1,
        kernel: int = 3,
        dilation: int | Sequence[int] = 1,
        padding: str = "renormalize",
        initialization: str = "linear",
    ) -> None:
        config = {name: value for name, value in locals().items() if name not in ("self", "__class__")}
        super().__init__()
        n_blocks = len(widths) if n_blocks is None else n_blocks
        steps = [dilation] if isinstance(dilation, int) else dilation
        sizes = n_planes, *grid, channels, stem_width, shuffle, stem_kernel, head_kernel, kernel, *steps, n_blocks
        sizes = *sizes, len(widths), len(steps)
        if len(grid) != 2 or min(sizes) < 1 or stem_kernel * head_kernel * kernel % 2 == 0:
            raise InputError("sizes of a network must be positive, and its kernels odd", got=sizes)
        if padding not in PADDINGS or initialization not in INITIALIZATIONS:
            expected = f"padding must be {' or '.join(PADDINGS)}, initialization {' or '.join(INITIALIZATIONS)}"
            raise InputError(expected, got=f"{padding} and {initialization}")
        schedule = stretched(widths, n_blocks)
        dilations = stretched(steps, n_blocks)
        del config["n_blocks"]
        self.config = config | {
            "grid": list(grid),
            "widths": schedule,
            "dilation": dilation if isinstance(dilation, int) else dilations,
        }
        self.n_planes = n_planes
        self.grid = (grid[0], grid[1])
        self.shuffle = shuffle
        self.reach = max(dilations) * (kernel // 2)
        outputs, samples = n_planes * channels * shuffle**2, grid[0] * grid[1] * channels * shuffle**2
        pairs = itertools.pairwise([stem_width, *schedule])
        self.trunk = nn.Sequential(
            StemConv2d(samples, stem_width, stem_kernel, channels if stem_by_colour else 1, shuffle**2),
            nn.ReLU(),
            *(
                ResBlock(a, b, activation, normalization, style, kernel, distance)
                for (a, b), distance in zip(pairs, dilations, strict=True)
            ),
            WideConv2d(schedule[-1], outputs, head_kernel, padding=head_kernel // 2),
            nn.ReLU(),
        )
        self.head = WideConv2d(outputs, outputs, head_kernel, padding=head_kernel // 2)
        # One place for each row and column from which the stem reads beyond the frame, and one for all others.
        places = 2 * (stem_kernel // 2) + 1
        self.gains = nn.Parameter(torch.ones(outputs, places, places)) if padding == "renormalize" else None

    def features(self, views: Tensor) -> Tensor:
        """Input of the last convolution: views [..., V, U, C, H, W] -> [B, N C r^2, H / r, W / r], rounded up."""
        check_views(views)
        expected = (*self.config["grid"], self.config["channels"])
        if tuple(views.shape[-5:-2]) != expected:
            grid = f"[{expected[0]},{expected[1]}]"
            reads, got = f"this network reads views [..., {', '.join(map(str, expected))}, H, W]", list(views.shape)
            remedy = f"set reader.angular_size={grid}, or scene.camera.grid={grid} for simulated scenes"
            raise InputError(reads, got=f"shape {got}", remedy=remedy)
        # Padding grows with the dilation: without a limit, a small file could ask for any amount of memory.
        if self.reach > max(views.shape[-2:]):
            raise InputError("blocks must reach no farther than the picture", got=f"{self.reach} pixels")
        return self.trunk(self._inputs(views))

    def forward(self, views: Tensor, slopes: Tensor | None = None) -> Tensor:
        """Refocus as in `Network`; the planes are fixed, and slopes are not read. The stack is >= 0."""
        height, width = views.shape[-2:]
        images = F.pixel_shuffle(self._outputs(views), self.shuffle)[..., :height, :width]
        return images.reshape(*views.shape[:-5], self.config["n_planes"], self.config["channels"], height, width)

    def ends(self) -> Iterator[nn.Parameter]:
        """Parameters of the stem, of both convolutions of the head and of the frame's edge."""
        gains = [] if self.gains is None else [self.gains]
        return itertools.chain(*(part.parameters() for part in (self.trunk[0], self.trunk[-2], self.head)), gains)

    @torch.no_grad()
    def initialize(self, views: Tensor, slopes: Tensor | None, labels: Tensor, total: Total = one_process) -> None:
        """Start the weights on crops: see `lfref.nets.initialization`."""
        targets = self._coarse(labels.flatten(1, 2))
        if self.config["initialization"] == "random":
            initialization.scale_outputs(self.head, self.features(views), targets, total)
            return
        stem, *_, first = (layer for layer in self.trunk if isinstance(layer, nn.Conv2d))
        directions = self._start_stem(stem, views, targets, total)
        for block in (layer for layer in self.trunk if isinstance(layer, ResBlock)):
            initialization.pass_through(block, directions.shape[1])
        decoder, offset = initialization.decoder(first, directions)
        rest = (
            (read, target - (decoder @ read.double().flatten(2) + offset[:, None]).view_as(target))
            for read, target in self._pairs(first, self.trunk[:-2], views, targets, HEAD_PIXELS)
        )
        weights, bias, _ = initialization.ridge_regression(rest, total)
        # The first convolution predicts the labels and OFFSET, the last one takes it off.
        first.weight.copy_((decoder + weights).reshape(first.weight.shape))
        nn.init.dirac_(self.head.weight)
        assert first.bias is not None
        assert self.head.bias is not None
        first.bias.copy_(offset + bias + initialization.OFFSET)
        self.head.bias.fill_(-initialization.OFFSET)
        if self.gains is not None:
            crops = zip(views.split(1), targets.split(1), strict=True)
            of_crops = ((self._outputs(crop), target) for crop, target in crops)
            self.gains.copy_(initialization.edge_gains(of_crops, self.gains, total))

    def _start_stem(self, stem: nn.Conv2d, views: Tensor, targets: Tensor, total: Total) -> Tensor:
        """Step 1 of the linear start; returns the directions of the labels that the stem carries, [N C r^2, K]."""
        n_colours, n_inner = int(self.config["channels"]), self.shuffle**2
        n_read = n_inner * math.prod(stem.kernel_size)
        by_colour = (
            (blocks.apart_by_colour(read, n_colours, n_read), blocks.apart_by_colour(target, n_colours, n_inner))
            for read, target in self._pairs(stem, nn.Identity(), views, targets, STEM_PIXELS)
        )
        weights, bias, covariance = initialization.ridge_regression(by_colour, total)
        half = max(1, min(self.config["stem_width"], *self.config["widths"]) // 2)
        # All directions of one colour's labels, or the principal ones that the filters can carry.
        predicted, n_kept = weights @ covariance @ weights.T, max(1, half // n_colours)
        principal = torch.linalg.eigh(predicted).eigenvectors[:, -n_kept:]
        of_one = principal if n_kept < len(predicted) else torch.eye(len(predicted)).to(predicted)
        directions = initialization.for_all_colours(of_one, n_colours, (n_inner, 1))[:, :half]
        if self.config["stem_by_colour"]:
            initialization.set_stem(stem, weights, bias, of_one)
        else:
            weights = initialization.for_all_colours(weights, n_colours, (n_inner, n_read))
            bias = bias.unflatten(0, (-1, 1, n_inner)).expand(-1, n_colours, -1).flatten()
            initialization.set_stem(stem, weights, bias, directions)
        return directions

    def _pairs(
        self, convolution: nn.Conv2d, layers: nn.Module, views: Tensor, targets: Tensor, n_pixels: int
    ) -> Iterator[tuple[Tensor, Tensor]]:
        """What a convolution reads after these layers, and the labels there, without the border of crops."""
        border = -(-START_BORDER // self.shuffle)
        rows, columns = (slice(border, -border) if size > 2 * border else slice(None) for size in targets.shape[-2:])
        every = -(-targets[:, 0].numel() // n_pixels)
        for crop, target in zip(views.split(1), targets.split(1), strict=True):
            read = initialization.neighbourhoods(layers(self._inputs(crop)), convolution)
            yield tuple(  # type: ignore[misc]
                each[..., rows, columns].flatten(2)[..., ::every, None] for each in (read, target)
            )

    def _outputs(self, views: Tensor) -> Tensor:
        """Stacks of views [..., V, U, C, H, W] on the coarser grid, [B, N C r^2, H / r, W / r], sizes rounded up."""
        images = torch.relu(self.head(self.features(views)))
        return images if self.gains is None else images * blocks.by_place(self.gains, *images.shape[-2:])

    def _inputs(self, views: Tensor) -> Tensor:
        """Views [..., V, U, C, H, W] as the channels of (coarse) pixels, [B, V U C r^2, H / r, W / r], rounded up."""
        return self._coarse(views.reshape(-1, math.prod(views.shape[-5:-2]), *views.shape[-2:]))

    def _coarse(self, images: Tensor) -> Tensor:
        """Images [B, K, H, W] on the coarser grid, [B, K r^2, H / r, W / r], sizes rounded up."""
        return F.pixel_unshuffle(blocks.padded(images, self.shuffle), self.shuffle)


def stretched(widths: Sequence[int], n_blocks: int) -> list[int]:
    """A schedule of widths resampled to another number of blocks; each block takes the nearest original width."""
    return [int(widths[(2 * i + 1) * len(widths) // (2 * n_blocks)]) for i in range(n_blocks)]
