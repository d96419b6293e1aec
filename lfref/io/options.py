"""Options of the reader as people give them: of the right kind before anything is read."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfref.errors import InputError, chosen
from lfref.io import lenslet_lattice as lattices
from lfref.io.lenslet_lattice import HEXAGONAL_ROWS, Lattice, Pair


def check(**given: Any) -> None:
    """Refuse options of another kind than theirs; None is no option, but where there must be one.

    Args:
        **given: Option of `lfref.read` -> its value.

    Raises:
        InputError: The first that does not fit.
    """
    for name, value in given.items():
        expected, fits = KINDS[name]
        if not fits(value) and (value is not None or name in NEEDED):
            raise InputError(f"{name} (reader.{name}) must be {expected}", got=repr(value))


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, float) or _is_whole(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool)


def _two(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list | tuple) and len(value) == 2 and all(map(fits, value))


KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "views": ("a whole number or [rows,columns]", lambda value: _is_whole(value) or _two(_is_whole)(value)),
    "start": ("a whole number", _is_whole),
    "reverse_v": ("true or false", _is_flag),
    "reverse_u": ("true or false", _is_flag),
    "pattern": ("text", _is_text),
    "lenslet": ("a whole number", _is_whole),
    "rotation": ("a number of degrees", _is_number),
    "scratch": ("a folder", lambda value: isinstance(value, str | Path)),
    "white": ("an image file", lambda value: isinstance(value, str | Path)),
    "size": ("[height,width] in whole pixels", _two(_is_whole)),
    "grid": ("[rows,columns]", _two(_is_whole)),
    "holes": ("true or false", _is_flag),
    "axes": ("letters such as vuhwc", _is_text),
    "variable": ("a name", _is_text),
    "positions": ("a CSV or JSON file, or names", lambda value: isinstance(value, str | Path)),
    "spacing": ("two numbers, as [1,1.1]", _two(_is_number)),
    "encoding": ("linear, srgb, gamma:EXPONENT, file or none", _is_text),
}
"""Option -> what it must be, and whether a value is."""
NEEDED = ("lenslet", "encoding")
"""Options that have a value by default."""


# PART options
# What is said about the lenslets of an image: pitch, offset, rotation, lattice, or a white image to find them by.

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
