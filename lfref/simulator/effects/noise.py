"""Shot and read noise: normally distributed, of variance a x + b at radiance x, independent from sample to sample.

Source: Foi et al., "Practical Poissonian-Gaussian noise modeling and fitting for single-image raw-data", 2008.
"""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from lfref.simulator import checks
from lfref.simulator.effects import Effect


@dataclass(frozen=True)
class Noise(Effect):
    """Noise of the sensor's samples."""

    shot: float = 0.0  # variance a per unit of radiance, [0, 1]; 1 / a is the number of electrons at radiance 1
    read: float = 0.0  # variance b in the dark, [0, 1]

    def __post_init__(self) -> None:
        checks.numbers("a noise's shot and read", [self.shot, self.read], 0, 1)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """The effect is inert if the variance is 0."""
        return None if self.shot or self.read else "shot and read noise are 0"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Add noise."""
        return noisy(views, self.shot, self.read, torch.randn(tuple(views.shape), generator=generator).to(views))


def noisy(views: Tensor, shot: float, read: float, draws: Tensor) -> Tensor:
    """Radiance of any shape plus noise from standard normal `draws`; below 0, the noise is the same as at 0."""
    variance = views.clamp(min=0) * shot + read
    # The root has no finite gradient at 0: the variance is at least 1e-20, and the root of that, 1e-10, is subtracted.
    return views + draws * (variance.clamp(min=1e-20).sqrt() - 1e-20**0.5)
