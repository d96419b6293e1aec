"""Effects of a camera's optics and sensor on views: the base of all effects."""

import abc

from torch import Generator, Tensor

from lfref.simulator import checks


class Effect(checks.Description, abc.ABC):
    """A frozen dataclass of plain numbers; `sensor.Sensor` has the order of all effects."""

    @abc.abstractmethod
    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Views [V, U, C, H, W] with the effect; C is 1 between mosaic and demosaicing."""
