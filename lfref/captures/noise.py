"""Noise: how its variance a x + b grows with the light x.

It is measured, never corrected: refocusing averages it away, and other thresholds lean on it.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from lfref.captures.defect import Correction, Evidence
from lfref.functional import noise_line
from lfref.lightfield import LightField


@dataclass(frozen=True)
class Noise:
    """Variance a x + b of a sample that holds the light x."""

    name: ClassVar[str] = "noise"

    shot: float = 0.0
    """Variance a for each unit of light."""
    read: float = 0.0
    """Variance b in the dark."""

    def inert(self) -> str | None:
        """Always: it is told, and left."""
        return f"only measured: {self.told()}"

    def told(self) -> str:
        """The standard deviations at three levels of light."""
        deviations = ", ".join(f"{self.deviation(light):.4f} at {light:g}" for light in (0.01, 0.1, 0.5))
        return f"standard deviation {deviations} (shot {self.shot:.2g}, read {self.read:.2g})"

    def deviation(self, light: float) -> float:
        """Standard deviation of a sample.

        Args:
            light: That it holds, at least 0.
        """
        return math.sqrt(self.shot * light + self.read)

    def corrected(self, field: LightField) -> LightField:
        """The same: noise stays."""
        return field


def find(evidence: Evidence) -> Noise:
    """Measure the noise.

    Args:
        evidence: Of the light field.
    """
    return Noise(*noise_line.measure(evidence.field))


NOISE = Correction(Noise, "flat parts of views", find, needs_light=True)
