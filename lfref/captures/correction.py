"""What every correction is: what it needs, what it found, when it is inert, and what it then does.

The simulator's plan turned round: there effects are put onto views where a scene calls for them, here they are taken
off where a capture shows them.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

from lfref.captures.evidence import Evidence
from lfref.lightfield import LightField


@runtime_checkable
class Finding(Protocol):
    """What was found of one defect: a frozen dataclass of plain numbers, texts, tuples of them, and tensors."""

    name: ClassVar[str]
    """As it is called in explanations and files."""

    def inert(self) -> str | None:
        """Why nothing is to be corrected; None if something is."""

    def told(self) -> str:
        """What was found, in one line, with units, and what of it cannot be known."""

    def corrected(self, field: LightField) -> LightField:
        """The field without the defect; itself stays as it is. Never called where inert.

        Args:
            field: Of the grid and size that the finding is of.
        """


class Correction(NamedTuple):
    """How one defect is found."""

    kind: type[Finding]
    """Of the findings."""
    needs: str
    """What it takes of a light field, for explanations."""
    find: Callable[[Evidence], Finding]
    """What is wrong; inert where the evidence does not reach."""
    needs_light: bool = False
    """Whether it measures and scales light, which samples as files encode them are not."""
