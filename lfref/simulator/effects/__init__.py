"""Effects of a camera's optics and sensor on views: the base of all effects."""

import abc

from torch import Generator, Tensor


class Effect(abc.ABC):
    """A frozen dataclass of plain numbers whose defaults change nothing; see `sensor.Sensor` for the order of all."""

    @abc.abstractmethod
    def inert(self, grid: tuple[int, int]) -> str | None:
        """The reason why it leaves views of so many rows and columns as they are; None if it may change them."""

    @abc.abstractmethod
    def apply(self, views: Tensor, generator: Generator) -> Tensor:
        """Views [V, U, C, H, W] with the effect. Random numbers are drawn on the CPU: the same on every device."""
