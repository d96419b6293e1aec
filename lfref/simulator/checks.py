"""Checks of scene descriptions: an unusable value is refused with one line that names it."""

import math
from collections.abc import Iterable

from lfref.errors import InputError


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


def pair(what: str, values: tuple[float, ...], least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse anything but two numbers within the limits."""
    _check_length(what, values, 2)
    numbers(what, values, least, most)


def span(what: str, values: tuple[float, ...], least: float = -math.inf, most: float = math.inf) -> None:
    """Refuse anything but two numbers within the limits, the smaller first."""
    pair(what, values, least, most)
    if values[0] > values[1]:
        raise InputError(f"{what} must go from small to large", got=values)


def colour(what: str, values: tuple[float, ...], least: float = 0.0, most: float = 1.0) -> None:
    """Refuse anything but three numbers (red, green, blue) within the limits."""
    _check_length(what, values, 3)
    numbers(what, values, least, most)


def _check_length(what: str, values: tuple[float, ...], length: int) -> None:
    if not isinstance(values, tuple) or len(values) != length:
        raise InputError(f"{what} must have {length} numbers", got=values)


def above_zero(what: str, *values: float) -> None:
    """Refuse values that are not finite and above 0."""
    numbers(what, values)
    if min(values) <= 0:
        raise InputError(f"{what} must be above 0", got=list(values))


def kind(what: str, value: object, base: type) -> None:
    """Refuse a part of a scene that is not an instance of a class; the error names the classes to choose from."""
    if not isinstance(value, base):
        classes = sorted(_leaf_classes(base), key=lambda cls: cls.__name__)
        remedy = f"in yaml, write _target_: {classes[0].__module__}.{classes[0].__name__}"
        expected = f"{what} must be one of {', '.join(cls.__name__ for cls in classes)}"
        raise InputError(expected, got=repr(value), remedy=remedy if isinstance(value, dict) else "")


def _leaf_classes(base: type) -> list[type]:
    subclasses: list[type] = base.__subclasses__()
    return [leaf for cls in subclasses for leaf in _leaf_classes(cls)] if subclasses else [base]
