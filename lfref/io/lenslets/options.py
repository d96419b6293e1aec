"""What is said about the lenslets of an image: pitch, offset, rotation, lattice, or a white image to find them by."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lfref.errors import InputError, chosen
from lfref.io.lenslets import lattice as lattices
from lfref.io.lenslets.lattice import HEXAGONAL_ROWS, Lattice, Pair

LATTICES = {"square": False, "hexagonal": True}
"""Whether every other row stands half a step further."""
ASPECTS = {"square": 1.0, "hexagonal": HEXAGONAL_ROWS}
"""Distance of rows in distances between lenslets, where one number is given for both."""
SHORTEST_PITCH = 2.0


@dataclass(frozen=True)
class Lenslets:
    """Lenslets as the options of a reader describe them; all None: the image is aligned with them already."""

    pitch: Pair | None = None
    """Distance of rows, and of the lenslets of a row, in pixels."""
    offset: Pair | None = None
    """Centre (y, x) of a lenslet, in pixels from the middle of the first pixel; None: half a pitch from the corner."""
    rotation: float | None = None
    """Degrees by which rows are turned, above 0 where they fall to the right."""
    lattice: str | None = None
    """A key of `LATTICES`; None: `square`, or what a white image shows."""
    white: Path | None = None
    """A white image of the camera, from which whatever is None is found."""

    @property
    def are_aligned(self) -> bool:
        """Whether nothing is said, so that whole pixels of the image are the views."""
        return self == ALIGNED

    def described(self) -> Lattice:
        """The lattice that the options describe without a white image.

        Raises:
            InputError: They do not say the pitch.
        """
        if self.pitch is None:
            remedy = "set reader.pitch, or reader.white to an image that shows the lenslets"
            raise InputError("a lenslet image needs the pitch of its lenslets", got="none", remedy=remedy)
        rows, columns = self.pitch
        offset = self.offset or ((rows - 1) / 2, (columns - 1) / 2)
        return lattices.upright(self.pitch, offset, self.rotation or 0.0, LATTICES[self.lattice or "square"])

    def over(self, found: Lattice) -> Lattice:
        """A lattice that was found, but for what the options say otherwise.

        Args:
            found: As a white image shows it.
        """
        if self.pitch is None and self.rotation is None and self.lattice in (None, found.name):
            return replace(found, origin=self.offset or found.origin)
        kept = Lenslets(
            self.pitch or found.pitch,
            self.offset or found.origin,
            found.rotation if self.rotation is None else self.rotation,
            self.lattice or found.name,
        )
        return kept.described()


ALIGNED = Lenslets()
"""Nothing is said."""


def parsed(
    pitch: float | Sequence[float] | None = None,
    offset: Sequence[float] | None = None,
    rotation: float | None = None,
    lattice: str | None = None,
    white: str | Path | None = None,
) -> Lenslets:
    """Lenslets as options write them.

    Args:
        pitch: In pixels, at least 2: of neighbours, or [rows, columns].
        offset: Centre [y, x] of a lenslet, in pixels from the middle of the first pixel.
        rotation: Degrees by which rows are turned, between -45 and 45, above 0 where they fall to the right.
        lattice: `square` or `hexagonal`.
        white: A white image of the camera.

    Raises:
        InputError: A value that cannot be.
    """
    if lattice is not None:
        chosen("reader.lattice", lattice, LATTICES)
    if rotation is not None and not abs(rotation) <= 45:
        remedy = "turn the image by 90 degrees if need be"
        raise InputError("reader.rotation must be -45 to 45 degrees", got=rotation, remedy=remedy)
    both = None if pitch is None else _both(pitch, ASPECTS[lattice or "square"])
    at = None if offset is None else _pair("reader.offset", offset)
    return Lenslets(both, at, rotation, lattice, None if white is None else Path(white))


def _both(pitch: float | Sequence[float], aspect: float) -> Pair:
    """The pitch of rows and columns, at least one pixel for each of two views."""
    both = _pair("reader.pitch", [pitch * aspect, pitch] if isinstance(pitch, int | float) else pitch)
    if not min(both) >= SHORTEST_PITCH * min(aspect, 1):
        raise InputError(f"reader.pitch must be at least {SHORTEST_PITCH:g} pixels", got=pitch)
    return both


def _pair(option: str, values: Sequence[float]) -> Pair:
    try:
        first, second = (float(value) for value in values)
    except (TypeError, ValueError) as error:
        raise InputError(f"{option} must be two numbers, of rows and columns", got=repr(values)) from error
    if not np.isfinite([first, second]).all():
        raise InputError(f"{option} must be finite", got=[first, second])
    return first, second
