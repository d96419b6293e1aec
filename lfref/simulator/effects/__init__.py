"""Effects of a camera's optics and sensor on views: the base of all effects."""

import abc

from torch import Generator, Tensor


class Effect(abc.ABC):
    """A frozen dataclass of plain numbers whose defaults change nothing; `sensor.Sensor` has the order of all effects.

    An effect whose default does change something has an inert form in `sensor.OFF`.
    """

    @abc.abstractmethod
    def inert(self, grid: tuple[int, int]) -> str | None:
        """Why the effect leaves views of a `grid` (V rows, U columns) as they are; None if it may change them."""

    @abc.abstractmethod
    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Views [V, U, C, H, W] with the effect; C is 1 between mosaic and demosaicing."""
