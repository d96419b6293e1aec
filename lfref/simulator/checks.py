"""Descriptions of scenes: frozen dataclasses of plain numbers, which are checked where they are made."""

import dataclasses
import functools
import math
import re
import types
from typing import Annotated, Any, ClassVar, get_args, get_origin, get_type_hints

from lfref.errors import InputError

Share = Annotated[float, 0, 1]
"""A number from 0 to 1; the two numbers after a type are the limits of its values."""
Positive = Annotated[float, math.ulp(0.0), math.inf]
NotNegative = Annotated[float, 0, math.inf]
Seed = Annotated[int, 0, math.inf]


class Description:
    """A part of a scene; subclasses are frozen dataclasses.

    Lists become tuples; values that do not fit the type of their field, and NaN or infinity, raise InputError.
    """

    lengths: ClassVar[tuple[str, ...]] = ()
    """Fields in pixels or in pixels per view step."""

    def __post_init__(self) -> None:
        kind: Any = type(self)  # mypy takes no class of dataclasses for hashable
        for name, hint in _hints(kind).items():
            value = _as_tuple(getattr(self, name))
            object.__setattr__(self, name, value)
            if not _fits(value, hint):
                text = hint.__name__ if isinstance(hint, type) else str(hint)
                text = re.sub(r"typing.Annotated\[(\w+), ([^,]+), ([^]]+)\]", r"\1 from \2 to \3", text)
                raise InputError(f"{kind.__name__}.{name} must be {text}", got=repr(value))


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _as_tuple(value: object) -> object:
    return tuple(map(_as_tuple, value)) if isinstance(value, list | tuple) else value


def _fits(value: Any, hint: Any) -> bool:
    parts = get_args(hint)
    if get_origin(hint) is Annotated:
        kind, low, high = parts
        return _fits(value, kind) and low <= value <= high
    if isinstance(hint, types.UnionType):
        return any(_fits(value, part) for part in parts)
    if get_origin(hint) is tuple:
        if not isinstance(value, tuple):
            return False
        hints = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        return len(value) == len(hints) and all(map(_fits, value, hints))
    return isinstance(value, int | float) and math.isfinite(value) if hint is float else isinstance(value, hint)
