"""Noise: the variance a x + b of a sample that holds the light x.

It is measured and never corrected: refocusing averages it away. Methods set their own limits by it.
A file of its own, as each defect has.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from lfref.lightfield import LightField


@dataclass(frozen=True)
class NoiseDefect:
    """Variance a x + b."""

    name: ClassVar[str] = "noise"
    needs_light: ClassVar[bool] = True

    shot: float = 0.0
    """Variance a per unit of light."""
    read: float = 0.0
    """Variance b in the dark."""

    def reason_to_skip(self) -> str | None:
        """Why nothing is corrected: noise is only measured."""
        return f"only measured: {self.summary()}"

    def summary(self) -> str:
        """Standard deviations at three levels of light."""
        deviations = ", ".join(f"{self.deviation(light):.4f} at {light:g}" for light in (0.01, 0.1, 0.5))
        return f"standard deviation {deviations} (shot {self.shot:.2g}, read {self.read:.2g})"

    def deviation(self, light: float) -> float:
        """Standard deviation of a sample that holds this light."""
        return math.sqrt(self.shot * light + self.read)

    def corrected(self, field: LightField) -> LightField:
        """The same light field."""
        return field
