"""Checks of scene descriptions: an unusable value is refused with one line that names it."""

import math
from collections.abc import Iterable

from lfref.errors import InputError

TINY = math.ulp(0.0)
"""The least number above 0."""


def freeze(description: object) -> None:
    """Turn the lists of a frozen dataclass, as yaml gives them, into tuples: call it in `__post_init__`."""
    for name, value in vars(description).items():
        if isinstance(value, list):
            object.__setattr__(description, name, _as_tuple(value))


def _as_tuple(value: object) -> object:
    return tuple(map(_as_tuple, value)) if isinstance(value, list | tuple) else value


def numbers(what: str, values: Iterable[float], least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse values that are not finite numbers from `least` to `most`; `what` names them in the error."""
    values = list(values)
    is_valid = all(
        isinstance(value, int | float) and math.isfinite(value) and least <= value <= most for value in values
    )
    if not is_valid:
        limits = [f"at least {least:g}"] * (least > -math.inf) + [f"at most {most:g}"] * (most < math.inf)
        raise InputError(f"{what} must be finite numbers" + ", ".join(["", *limits]), got=values)


def pair(
    what: str, values: tuple[float, ...], least: float = -math.inf, most: float = math.inf, count: int = 2
) -> None:
    """Refuse anything but two numbers, or `count`, within the limits."""
    if not isinstance(values, tuple) or len(values) != count:
        raise InputError(f"{what} must have {count} numbers", got=values)
    numbers(what, values, least, most)


def colour(what: str, values: tuple[float, ...], least: float = 0.0, most: float = 1.0) -> None:
    """Refuse anything but three numbers (red, green, blue) within the limits."""
    pair(what, values, least, most, count=3)


def kind(what: str, value: object, base: type) -> None:
    """Refuse a part of a scene that is not an instance of a class."""
    if not isinstance(value, base):
        raise InputError(f"{what} must be a {base.__name__}", got=repr(value))
