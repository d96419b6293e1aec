"""Shot and read noise: normally distributed, of variance a x + b at radiance x, independent from sample to sample.

Source: Foi et al., "Practical Poissonian-Gaussian noise modeling and fitting for single-image raw-data", 2008.
"""

from dataclasses import dataclass
from typing import ClassVar

from torch import Generator, Tensor

from lfref.simulator import checks
from lfref.simulator.effects.effect import normal

TINY = 1e-20  # variance below which there is no noise: the square root has no slope at 0


@dataclass(frozen=True)
class Noise:
    """Noise of the sensor's samples."""

    name: ClassVar[str] = "noise"
    needs: ClassVar[tuple[str, ...]] = ("mosaicked",)
    makes: ClassVar[str] = "noisy"

    shot: float = 0.0
    """Variance a for each unit of radiance, [0, 1]; 1 / a is the number of electrons at radiance 1."""
    read: float = 0.0
    """Variance b in the dark, [0, 1]."""

    def __post_init__(self) -> None:
        checks.numbers("a noise's shot and read", [self.shot, self.read], 0, 1)

    def inert(self, grid: tuple[int, int]) -> str | None:
        """Nothing changes where the variance is 0."""
        return None if self.shot or self.read else "shot and read noise are 0"

    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """See `noisy`; its draws are standard normal."""
        return noisy(views, self.shot, self.read, normal(tuple(views.shape), generator, views))


def noisy(views: Tensor, shot: float, read: float, draws: Tensor) -> Tensor:
    """Add noise to samples.

    Args:
        views: Radiance, any shape; what lies below 0 has the noise of 0.
        shot: Variance for each unit of radiance.
        read: Variance at radiance 0.
        draws: Standard normal, of the views' shape.
    """
    variance = views.clamp(min=0) * shot + read
    return views + draws * (variance.clamp(min=TINY).sqrt() - TINY**0.5)
