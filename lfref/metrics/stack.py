"""Quality of refocused stacks: SSIM and PSNR of each focal plane, and their mean over the planes.

Letters: `N C H W` focal plane, channel, pixel row, pixel column. Source: MSSIM and MPSNR, the paper's Eq. 4-5.
"""

from abc import abstractmethod

import torch
from torch import Tensor
from torchmetrics import Metric

from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim


class StackQuality(Metric):
    """Mean over all stacks of an image quality, plane by plane; subclasses name the quality.

    Args:
        n_planes: Number N of focal planes in a stack.
        data_range: Difference between white and black, finite and above 0.

    Raises:
        InputError: `n_planes` is below 1.
    """

    full_state_update = False
    higher_is_better = True
    total: Tensor
    """Sum of the quality over the stacks, float64, [N]."""
    count: Tensor
    """Number of stacks."""

    def __init__(self, n_planes: int = 16, data_range: float = 1.0) -> None:
        super().__init__()
        if n_planes < 1:
            raise InputError("n_planes must be at least 1", got=n_planes)
        self.n_planes = n_planes
        self.data_range = data_range
        self.add_state("total", torch.zeros(n_planes, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.zeros((), dtype=torch.int64), dist_reduce_fx="sum")

    @staticmethod
    @abstractmethod
    def quality(prediction: Tensor, target: Tensor, data_range: float) -> Tensor:
        """Quality of each image, [..., C, H, W] twice -> [...]."""

    def update(self, prediction: Tensor, target: Tensor) -> None:
        """Add refocused stacks, [..., N, C, H, W] twice.

        Raises:
            InputError: The stacks are not comparable, or have another number of planes.
        """
        if prediction.ndim < 4 or prediction.shape[-4] != self.n_planes:
            raise InputError(f"stacks must be [..., {self.n_planes}, C, H, W]", got=list(prediction.shape))
        values = self.quality(prediction, target, self.data_range).reshape(-1, self.n_planes)
        self.total += values.sum(0, dtype=torch.float64)
        self.count += len(values)

    def compute(self) -> Tensor:
        """Mean over the stacks and the planes, a float64 scalar; NaN before the first update."""
        return self._plane_means().mean()

    def per_plane(self) -> Tensor:
        """Mean over the stacks of every process, one value per plane, float64, [N]."""
        with self.sync_context(
            dist_sync_fn=self.dist_sync_fn, should_sync=self._to_sync, should_unsync=self._should_unsync
        ):
            return self._plane_means()

    def _plane_means(self) -> Tensor:
        """Mean over the stacks in the present state, [N]."""
        return self.total / self.count


class MSSIM(StackQuality):
    """Mean structural similarity over the planes, [-1, 1]; the paper's Eq. 4."""

    quality = staticmethod(ssim)


class MPSNR(StackQuality):
    """Mean PSNR over the planes in dB, each image capped at 100 dB; the paper's Eq. 5."""

    quality = staticmethod(psnr)
