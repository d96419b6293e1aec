"""Quality of refocused stacks: SSIM and PSNR of each focal plane, their mean over the planes, and the share explained.

Letters: `N C H W` focal plane, channel, pixel row, pixel column. Source: MSSIM and MPSNR, the paper's Eq. 4-5.
"""

from abc import abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor
from torchmetrics import Metric

from lfref.errors import InputError, chosen
from lfref.functional.psnr import MEAN_CAP_DB, psnr
from lfref.functional.ssim import ssim


class StackQuality(Metric):
    """Mean over all stacks of `n_planes` planes of an image quality, plane by plane; subclasses name the quality."""

    full_state_update = False
    higher_is_better = True
    total: Tensor
    """Sum of the quality over the stacks, float64, [N]."""
    count: Tensor
    """Number of stacks."""

    def __init__(self, n_planes: int = 16, data_range: float = 1.0) -> None:
        super().__init__()
        self.n_planes = n_planes
        self.data_range = data_range
        self.add_state("total", torch.zeros(n_planes, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    @staticmethod
    @abstractmethod
    def quality(prediction: Tensor, target: Tensor, data_range: float) -> Tensor:
        """Quality of each image, [..., C, H, W] twice -> [...]."""

    def update(self, prediction: Tensor, target: Tensor) -> None:
        """Add refocused stacks, [..., N, C, H, W] twice; InputError if they are not comparable."""
        if prediction.ndim < 4 or prediction.shape[-4] != self.n_planes:
            raise InputError(f"stacks must be [..., {self.n_planes}, C, H, W]", got=list(prediction.shape))
        values = self.quality(prediction, target, self.data_range).reshape(-1, self.n_planes)
        self.total += values.sum(0, dtype=torch.float64)
        self.count += len(values)

    def compute(self) -> Tensor:
        """Mean over the stacks and the planes, a float64 scalar; NaN before the first update."""
        return (self.total / self.count).mean()

    def per_plane(self) -> Tensor:
        """Mean over the stacks of every process, one value per plane, float64, [N]."""
        with self.sync_context(
            dist_sync_fn=self.dist_sync_fn, should_sync=self._to_sync, should_unsync=self._should_unsync
        ):
            return self.total / self.count


class MSSIM(StackQuality):
    """Mean structural similarity over the planes, [-1, 1]; the paper's Eq. 4."""

    quality = staticmethod(ssim)


class MPSNR(StackQuality):
    """Mean PSNR over the planes in dB, of at most 70 dB each; the paper's Eq. 5."""

    @staticmethod
    def quality(prediction: Tensor, target: Tensor, data_range: float) -> Tensor:
        """PSNR of each image as it counts in means."""
        return psnr(prediction, target, data_range).clamp(max=MEAN_CAP_DB)


NEAR, WIDE = 0.5, 3.0
"""Near focus: |slope| up to NEAR (the paper's alpha from .75); wide blur: |slope| from WIDE (alpha up to .25)."""
GROUPS = {"all": (0.0, float("inf")), "near": (0.0, NEAR), "wide": (WIDE, float("inf"))}
"""Least and largest |slope| of the planes that count."""


def in_group(slopes: Sequence[float], group: str) -> list[bool]:
    """Whether each plane belongs to a group of `GROUPS`; slope 0, where the label is the mean of the views, to none."""
    low, high = chosen("group of planes", group, GROUPS)
    return [slope != 0 and low <= abs(slope) <= high for slope in slopes]


class Explained(Metric):
    """Share of refocusing that a stack explains: 1 - sum (stack - label)^2 / sum (mean of views - label)^2.

    The mean of the views, which is no refocusing at all, has 0, and the label itself 1. Sums go over stacks, planes and
    pixels before the division.

    Args:
        slopes: Slopes of the planes, in pixels per view step, [N].
        group: Planes that count, one of `GROUPS`.

    Raises:
        InputError: Another group.

    Example:
        >>> metric = Explained([-0.5, 0.0, 0.5])
        >>> labels, mean = torch.rand(2, 3, 3, 8, 8), torch.rand(2, 3, 8, 8)
        >>> metric(mean[:, None].expand_as(labels), labels, mean)
        tensor(0., dtype=torch.float64)
    """

    full_state_update = False
    higher_is_better = True
    error: Tensor
    """Sum of squared errors of the stacks, float64."""
    rival: Tensor
    """Sum of squared errors of the mean of the views, float64."""

    def __init__(self, slopes: Sequence[float], group: str = "all") -> None:
        super().__init__()
        self.planes = in_group(slopes, group)
        self.add_state("error", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rival", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, prediction: Tensor, target: Tensor, mean: Tensor) -> None:
        """Add refocused stacks and labels, [..., N, C, H, W] each, and the means of their views, [..., C, H, W]."""
        for i in (i for i, counts in enumerate(self.planes) if counts):
            stack, label = prediction[..., i, :, :, :], target[..., i, :, :, :]
            self.error += (stack - label).double().square().sum()
            self.rival += (mean - label).double().square().sum()

    def compute(self) -> Tensor:
        """The share, a float64 scalar of at most 1; NaN where the labels are the mean of the views."""
        return torch.where(self.rival > 0, 1 - self.error / self.rival, torch.nan)
