"""Options of `lfref.read`: checked before anything is read, and in one form afterwards."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfref.errors import InputError, chosen

Pair = tuple[float, float]
"""Two numbers: of rows and of columns, or (y, x) in pixels."""
LENSLET = 14
"""Number of views along each axis of the ESLF images of the Stanford archive."""
ROW_DISTANCES = {"square": 1.0, "hexagonal": math.sqrt(3) / 2}
"""Lattice -> distance between its rows, in distances between neighbours of a row."""
SHORTEST_PITCH = 2.0
"""Shortest pitch, in pixels: one for each of two views."""


@dataclass(frozen=True)
class ReadOptions:
    """Options as `lfref.read` describes them; `parse` checks them. `views` and `grid` count as the file does."""

    views: tuple[int, int] | None = None
    start: int | None = None
    transpose: bool = False
    reverse_v: bool = False
    reverse_u: bool = False
    pattern: str | None = None
    lenslet: int = LENSLET
    pitch: Pair | None = None
    """Distance between rows, and between the lenslets of a row, in pixels."""
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

    @classmethod
    def parse(cls, **options: Any) -> "ReadOptions":
        """Options from the values that a user wrote; a pair may be a list.

        Raises:
            InputError: An option cannot be used.
        """
        try:
            return cls._parsed(options)
        except (TypeError, ValueError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            expected = "options of the reader must be of the kinds that lfref.read names"
            raise InputError(
                expected, got=", ".join(f"{name}={value!r}" for name, value in options.items() if value)
            ) from error

    @classmethod
    def _parsed(cls, options: dict[str, Any]) -> "ReadOptions":
        if options.get("lenslet", LENSLET) < 1:
            raise InputError("lenslet (reader.lenslet) must be at least 1 pixel", got=options["lenslet"])
        lattice, rotation, pitch = (options.get(name) for name in ("lattice", "rotation", "pitch"))
        if lattice is not None:
            chosen("reader.lattice", lattice, ROW_DISTANCES)
        if rotation is not None and not abs(rotation) <= 45:
            remedy = "turn the image by 90 degrees if need be"
            raise InputError("reader.rotation must be -45 to 45 degrees", got=rotation, remedy=remedy)
        row_distance = ROW_DISTANCES[lattice or "square"]
        if isinstance(pitch, int | float):
            options["pitch"] = pitch * row_distance, pitch
        for name in ("pitch", "offset"):
            if (values := options.get(name)) is not None:
                options[name] = float(values[0]), float(values[1])
                if not all(map(math.isfinite, options[name])):
                    raise InputError(f"reader.{name} must be finite", got=list(options[name]))
        if pitch is not None and min(options["pitch"]) < SHORTEST_PITCH * min(row_distance, 1):
            raise InputError(f"reader.pitch must be at least {SHORTEST_PITCH:g} pixels", got=pitch)
        if (spacing := options.get("spacing")) is not None and not all(0 < step < math.inf for step in spacing):
            got, remedy = list(spacing), "for example reader.spacing=[1,1.1]"
            raise InputError("spacing must be two steps above 0, of rows and of columns", got=got, remedy=remedy)
        if isinstance(views := options.get("views"), int):
            options["views"] = views, views
        if options.get("transpose"):
            # Users count rows and columns of the light field, decoders those of the file.
            options |= {name: options[name][::-1] for name in ("views", "grid") if options.get(name) is not None}
        for name, form in (("white", Path), ("positions", str)):
            if options.get(name) is not None:
                options[name] = form(options[name])
        checked: dict[str, Any] = {}
        for name, value in options.items():
            checked[name] = tuple(value) if isinstance(value, list) else value
        return cls(**checked)

    @property
    def describes_lenslets(self) -> bool:
        """Whether any option says where lenslets stand; else they are aligned with the pixels of the image."""
        return any(getattr(self, name) is not None for name in ("pitch", "offset", "rotation", "lattice", "white"))

    def window(self, grid: Sequence[int], path: Path, views: tuple[int, int] | None = None) -> tuple[slice, slice]:
        """Rows and columns to keep of a grid in the file at `path`; their numbers are `views`, else the option `views`.

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
