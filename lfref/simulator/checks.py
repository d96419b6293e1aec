"""Checks that the descriptions of a scene share: what is not usable is refused with one clear line."""

import math
from collections.abc import Iterable

from lfref.errors import InputError


def freeze(description: object) -> None:
    """Turn the lists of a frozen dataclass, as yaml gives them, into tuples, so that it can be hashed.

    Args:
        description: The dataclass, within its `__post_init__`.
    """
    for name, value in vars(description).items():
        if isinstance(value, list):
            object.__setattr__(description, name, _frozen(value))


def _frozen(value: object) -> object:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def numbers(what: str, values: Iterable[float], least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse what is no finite number of a range.

    Args:
        what: Name of the values, for the error.
        values: Should be finite and from `least` to `most`.
        least: Smallest legal value.
        most: Largest legal value.

    Raises:
        InputError: One of them is not.
    """
    values = list(values)
    is_legal = all(
        isinstance(value, int | float) and math.isfinite(value) and least <= value <= most for value in values
    )
    if not is_legal:
        limits = [f"at least {least:g}"] * (least > -math.inf) + [f"at most {most:g}"] * (most < math.inf)
        raise InputError(f"{what} must be finite numbers" + ", ".join(["", *limits]), got=values)


def pair(what: str, values: tuple[float, ...], least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse what is no pair of finite numbers; arguments as in `numbers`."""
    _of_length(what, values, 2)
    numbers(what, values, least, most)


def span(what: str, values: tuple[float, ...], least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse what is no pair of finite numbers from small to large; arguments as in `numbers`."""
    pair(what, values, least, most)
    if values[0] > values[1]:
        raise InputError(f"{what} must go from small to large", got=values)


def colour(what: str, values: tuple[float, ...], least: float = 0.0, most: float = 1.0) -> None:
    """Refuse what is not one number of a range each for red, green and blue; arguments as in `numbers`."""
    _of_length(what, values, 3)
    numbers(what, values, least, most)


def _of_length(what: str, values: tuple[float, ...], length: int) -> None:
    if not isinstance(values, tuple) or len(values) != length:
        raise InputError(f"{what} must have {length} numbers", got=values)


def above_zero(what: str, *values: float) -> None:
    """Refuse what is not finite and above 0.

    Args:
        what: Name of the values, for the error.
        values: The values.

    Raises:
        InputError: One of them is not.
    """
    numbers(what, values)
    if min(values) <= 0:
        raise InputError(f"{what} must be above 0", got=list(values))


def kind(what: str, value: object, wanted: type) -> None:
    """Refuse a part of a scene that is of another kind.

    Args:
        what: Name of the part, for the error.
        value: The part.
        wanted: Class that it must be of.

    Raises:
        InputError: It is not.
    """
    if not isinstance(value, wanted):
        raise InputError(f"{what} must be one of {', '.join(sorted(_kinds(wanted)))}", got=repr(value))


def _kinds(wanted: type) -> list[str]:
    below: list[type] = wanted.__subclasses__()
    return [name for cls in below for name in _kinds(cls)] if below else [wanted.__name__]
