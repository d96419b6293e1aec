"""Options of `lfref.read`, all in one place: checked before anything is read, and in one form afterwards."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from lfref.errors import InputError, chosen
from lfref.io.lenslet_lattice import HEXAGONAL_ROWS, Pair

LENSLET = 14
"""Views along each axis of the ESLF images of the Stanford archive."""
ROW_DISTANCES = {"square": 1.0, "hexagonal": HEXAGONAL_ROWS}
"""Lattice -> distance of its rows, in distances between neighbours of a row."""
SHORTEST_PITCH = 2.0
"""Pixels: one for each of two views."""


@dataclass(frozen=True)
class ReadOptions:
    """Options as `lfref.read` describes them; `parse` checks them."""

    views: tuple[int, int] | None = None
    start: int | None = None
    reverse_v: bool = False
    reverse_u: bool = False
    pattern: str | None = None
    lenslet: int = LENSLET
    pitch: Pair | None = None
    """Distance of rows, and of the lenslets of a row, in pixels."""
    offset: Pair | None = None
    rotation: float | None = None
    lattice: str | None = None
    """A key of `ROW_DISTANCES`."""
    white: Path | None = None
    size: tuple[int, int] | None = None
    grid: tuple[int, int] | None = None
    holes: bool | None = None
    axes: str | None = None
    variable: str | None = None
    positions: str | None = None
    spacing: Pair | None = None
    encoding: str = "file"
    scratch: Path | None = None

    @classmethod
    def parse(cls, **options: Any) -> "ReadOptions":
        """Options as a user wrote them, lists for pairs among them.

        Raises:
            InputError: The first option that cannot be used, by name.
        """
        for name, value in options.items():
            expected, fits = KINDS[name]
            if not (fits(value) or (value is None and name not in ("lenslet", "encoding"))):
                raise InputError(f"{name} (reader.{name}) must be {expected}", got=repr(value))
        lattice, rotation, pitch = (options.get(name) for name in ("lattice", "rotation", "pitch"))
        if lattice is not None:
            chosen("reader.lattice", lattice, ROW_DISTANCES)
        if rotation is not None and not abs(rotation) <= 45:
            remedy = "turn the image by 90 degrees if need be"
            raise InputError("reader.rotation must be -45 to 45 degrees", got=rotation, remedy=remedy)
        if pitch is not None:
            rows = ROW_DISTANCES[lattice or "square"]
            both = [pitch * rows, pitch] if isinstance(pitch, int | float) else pitch
            options["pitch"] = _finite_pair("pitch", both)
            if not min(options["pitch"]) >= SHORTEST_PITCH * min(rows, 1):
                raise InputError(f"reader.pitch must be at least {SHORTEST_PITCH:g} pixels", got=pitch)
        if options.get("offset") is not None:
            options["offset"] = _finite_pair("offset", options["offset"])
        if (spacing := options.get("spacing")) is not None and not all(0 < step < math.inf for step in spacing):
            got, remedy = list(spacing), "for example reader.spacing=[1,1.1]"
            raise InputError("spacing must be two steps above 0, of rows and of columns", got=got, remedy=remedy)
        if isinstance(views := options.get("views"), int):
            options["views"] = views, views
        for name in ("white", "scratch"):
            options[name] = None if options.get(name) is None else Path(options[name])
        if options.get("positions") is not None:
            options["positions"] = str(options["positions"])
        checked: dict[str, Any] = {}
        for name, value in options.items():
            checked[name] = tuple(value) if isinstance(value, list) else value
        return cls(**checked)

    def changed(self) -> list[str]:
        """Names of the options that are not the default."""
        return [field.name for field in fields(self) if getattr(self, field.name) != field.default]

    @property
    def describes_lenslets(self) -> bool:
        """Whether any option tells where lenslets stand; else they are aligned with the pixels of the image."""
        return any(getattr(self, name) is not None for name in ("pitch", "offset", "rotation", "lattice", "white"))

    def window(self, grid: Sequence[int], path: Path, views: tuple[int, int] | None = None) -> tuple[slice, slice]:
        """Rows and columns of views to keep.

        Args:
            grid: Rows and columns of views in the file.
            path: File or folder, for messages.
            views: Rows and columns to keep instead of the option `views`.

        Raises:
            InputError: The window is empty or leaves the grid.
        """
        slices = []
        for n_views, count in zip(grid, views or self.views or grid, strict=True):
            # Rounded up, so that 7 of 14 are views 4 to 10, whose centre 7 is the usual reference view.
            first = (n_views - count + 1) // 2 if self.start is None else self.start
            if count < 1 or first < 0 or first + count > n_views:
                got = f"views {count}, start {'in the middle' if self.start is None else first}"
                remedy = "choose views and start to fit (reader.views and reader.start of a command)"
                raise InputError(f"views to keep must be among the {n_views} of {path}", got=got, remedy=remedy)
            slices.append(slice(first, first + count))
        return slices[0], slices[1]


def _finite_pair(option: str, values: Any) -> Pair:
    try:
        first, second = (float(value) for value in values)
    except (TypeError, ValueError) as error:
        raise InputError(f"reader.{option} must be two numbers, of rows and columns", got=repr(values)) from error
    if not (math.isfinite(first) and math.isfinite(second)):
        raise InputError(f"reader.{option} must be finite", got=[first, second])
    return first, second


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _number(value: Any) -> bool:
    return isinstance(value, float) or _whole(value)


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


def _path(value: Any) -> bool:
    return isinstance(value, str | Path)


def _pair_of(value: Any, fits: Callable[[Any], bool]) -> bool:
    return isinstance(value, list | tuple) and len(value) == 2 and all(map(fits, value))


KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "views": ("a whole number or [rows,columns]", lambda value: _whole(value) or _pair_of(value, _whole)),
    "start": ("a whole number", _whole),
    "reverse_v": ("true or false", _flag),
    "reverse_u": ("true or false", _flag),
    "pattern": ("text", _text),
    "lenslet": ("a whole number", _whole),
    "pitch": ("pixels, one number or two", lambda value: True),
    "offset": ("two numbers", lambda value: True),
    "rotation": ("a number of degrees", _number),
    "lattice": (" or ".join(ROW_DISTANCES), _text),
    "white": ("an image file", _path),
    "size": ("[height,width] in whole pixels", lambda value: _pair_of(value, _whole)),
    "grid": ("[rows,columns]", lambda value: _pair_of(value, _whole)),
    "holes": ("true or false", _flag),
    "axes": ("letters such as vuhwc", _text),
    "variable": ("a name", _text),
    "positions": ("a CSV or JSON file, or names", _path),
    "spacing": ("two numbers, as [1,1.1]", lambda value: _pair_of(value, _number)),
    "encoding": ("linear, srgb, gamma:EXPONENT, file or none", _text),
    "scratch": ("a folder", _path),
}
"""Option -> what it must be, and whether a value is. `_finite_pair` checks pitch and offset."""
