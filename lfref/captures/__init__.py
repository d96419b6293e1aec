"""Defects of captured light fields: each module estimates and corrects one or two; `correct` runs all in order."""

import abc
from dataclasses import dataclass
from typing import ClassVar

from lfref.lightfield import LightField


@dataclass(frozen=True, eq=False)
class Defect(abc.ABC):
    """A defect that shows: a frozen dataclass; estimates return it, or in a text why there is nothing to correct."""

    name: ClassVar[str]
    needs_light: ClassVar[bool] = False
    """Whether its estimate or correction needs linear light, so that encoded samples do not allow it."""

    @abc.abstractmethod
    def summary(self) -> str:
        """The estimate in one line, with units, and what remains unknown."""

    @abc.abstractmethod
    def corrected(self, field: LightField) -> LightField:
        """A light field of the same grid and size without the defect."""
