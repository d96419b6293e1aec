"""Textbook formulas: losses, metrics, operators and network layers as they are in wide use, for comparison with ours.

On benign input in float32, each formula is as accurate as its definition allows.
Letters: `x y` prediction and target, [B, C, H, W]; `u v` view column and row, `s` slope in pixels per view step.
"""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from lfref import geometry
from lfref.functional.psnr import CEILING_DB
from lfref.losses.composite import paper_weights
from lfref.nets.blocks import InstanceNorm2d

_DIMENSIONS = (-3, -2, -1)


def mse(x: Tensor, y: Tensor) -> Tensor:
    """PyTorch's squared error, averaged in the type of the images, [B]."""
    return F.mse_loss(x, y, reduction="none").mean(_DIMENSIONS)


def l1(x: Tensor, y: Tensor) -> Tensor:
    """PyTorch's absolute error, [B]."""
    return F.l1_loss(x, y, reduction="none").mean(_DIMENSIONS)


def psnr(x: Tensor, y: Tensor) -> Tensor:
    """Torchmetrics' PSNR, capped as ours is, so that identical images have a value, [B]."""
    values = [peak_signal_noise_ratio(a, b, data_range=1.0) for a, b in zip(x, y, strict=True)]
    return torch.stack(values).clamp(max=CEILING_DB)


def inverse_psnr(x: Tensor, y: Tensor) -> Tensor:
    """The paper's psi_2, [B]."""
    return 1 / (-10 * torch.log10(mse(x, y)))


def one_minus_ssim(x: Tensor, y: Tensor) -> Tensor:
    """1 - torchmetrics' SSIM, [B]."""
    values = structural_similarity_index_measure(x, y, data_range=1.0, reduction="none")
    assert isinstance(values, Tensor)
    return 1 - values.reshape(-1)


def composite(x: Tensor, y: Tensor) -> Tensor:
    """The paper's loss as the weighted sum of these terms, [B]."""
    weights, terms = paper_weights(), {"mse": mse, "l1": l1, "ssim": one_minus_ssim, "inverse_psnr": inverse_psnr}
    return torch.stack([weights[name] * term(x, y) for name, term in terms.items()]).sum(0)


def grid_sample(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Shift-and-sum by `grid_sample` with repeated edges, in the type of the views, [N, C, H, W]."""
    share = weights.to(views.dtype) / weights.to(views.dtype).sum()
    return torch.stack([_warped(views, float(slope), share) for slope in slopes])


def _warped(views: Tensor, slope: float, share: Tensor) -> Tensor:
    # grid_sample takes coordinates in [-1, 1], x first.
    height, width = views.shape[-2:]
    rows, columns = (slope * geometry.angular_offsets(n) for n in share.shape)
    scale = torch.tensor([2 / max(width - 1, 1), 2 / max(height - 1, 1)])
    centre = torch.tensor([width - 1, height - 1]) / 2
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    grid = torch.stack(
        [x + columns[:, None, None].expand(-1, *x.shape), y + torch.zeros_like(columns)[:, None, None]], -1
    )
    total = torch.zeros_like(views[0, 0])
    for v in range(share.shape[0]):
        moved = grid + torch.tensor([0.0, float(rows[v])])
        samples = F.grid_sample(
            views[v], ((moved - centre) * scale).to(views.dtype), padding_mode="border", align_corners=True
        )
        total = total + (samples * share[v, :, None, None, None]).sum(0)
    return total


def phase_ramps(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Fourier shifts with phases in float32 and without a rule for the Nyquist bin, [N, C, H, W]."""
    share, size = weights.to(views.dtype) / weights.to(views.dtype).sum(), views.shape[-2:]
    spectra = torch.fft.rfft2(views * share[:, :, None, None, None])
    ky, kx = torch.fft.fftfreq(size[0])[:, None], torch.fft.rfftfreq(size[1])
    v, u = (geometry.angular_offsets(n).float() for n in share.shape)
    crossing = v[:, None, None, None] * ky + u[:, None, None] * kx
    ramps = [torch.exp(2j * torch.pi * float(slope) * crossing)[:, :, None] for slope in slopes]
    return torch.stack([torch.fft.irfft2((spectra * ramp).sum((0, 1)), s=size) for ramp in ramps])


class Softplus(nn.Module):
    """log(1 + e^x), computed as it is written; e^x overflows."""

    def forward(self, features: Tensor) -> Tensor:
        """Softplus of each element of features of any shape."""
        return torch.log(1 + torch.exp(features))


class Standardized(nn.Module):
    """(x - mean) / deviation as the paper writes it, without a constant in the denominator.

    Mean and deviation are taken over `axes` of [B, groups, C / groups, H, W]; without `groups`, a group per channel.
    """

    def __init__(self, axes: tuple[int, ...], groups: int | None = None) -> None:
        super().__init__()
        self.axes, self.groups = axes, groups

    def forward(self, features: Tensor) -> Tensor:
        """Standardized features, [B, C, H, W]."""
        groups = self.groups or features.shape[1]
        split = features.reshape(len(features), groups, -1, *features.shape[-2:])
        deviation, mean = torch.std_mean(split, self.axes, correction=0, keepdim=True)
        return ((split - mean) / deviation).reshape(features.shape)


def with_textbook_layers(network: nn.Module) -> nn.Module:
    """Replace PyTorch's softplus and normalisations (scale 1 and offset 0) by textbook layers, in place."""
    for module in network.modules():
        for name, child in module.named_children():
            if type(child) in REPLACEMENTS:
                setattr(module, name, REPLACEMENTS[type(child)](child))
    return network


REPLACEMENTS: dict[type, Callable[..., nn.Module]] = {
    nn.Softplus: lambda old: Softplus(),
    InstanceNorm2d: lambda old: Standardized((2, 3, 4)),
    nn.BatchNorm2d: lambda old: Standardized((0, 2, 3, 4)),
    nn.GroupNorm: lambda old: Standardized((2, 3, 4), old.num_groups),
}
