"""Options of the reader as people give them: of the right kind before anything is read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfref.errors import InputError


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
