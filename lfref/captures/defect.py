"""What all defects of a capture have in common."""

import abc
import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from lfref.lightfield import LightField


@dataclass(frozen=True, eq=False)
class Defect(abc.ABC):
    """An estimated defect: a frozen dataclass of numbers, texts, tuples of them, and tensors."""

    name: ClassVar[str]
    """Its name in reports and files."""
    needs_light: ClassVar[bool] = False
    """Whether its estimate or correction needs linear light, so that encoded samples do not allow it."""

    reason_to_skip: str = dataclasses.field(default="", kw_only=True)
    """Why nothing is corrected, as the estimate found; empty: `corrected` does something."""

    @abc.abstractmethod
    def summary(self) -> str:
        """The estimate in one line, with units, and what remains unknown."""

    @abc.abstractmethod
    def corrected(self, field: LightField) -> LightField:
        """A light field of the same grid and size without the defect; called only without a reason to skip."""
