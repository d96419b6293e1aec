"""What readers get and return: options that choose views, and the samples of those views with their weight apart.

Views that are stored one by one stand in the cells of a grid; a cell without a view is a hole, whose weight is 0.
Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfref.encoding import Encoding
from lfref.errors import FileError, InputError

Source = TypeVar("Source")
Pair = tuple[float, float]
"""Two numbers: of rows and of columns, or (y, x) in pixels."""
Cell = tuple[int, int]
"""Row and column of a view, from 0."""
LENSLET = 14
"""Number of views along each axis of the ESLF images of the Stanford archive."""
ROW_DISTANCES = {"square": 1.0, "hexagonal": math.sqrt(3) / 2}
"""Lattice -> distance between its rows, in distances between neighbours of a row."""
SHORTEST_PITCH = 2.0
"""Shortest pitch, in pixels: one for each of two views."""
WHITES = (1.0, 255.0, 1023.0, 4095.0, 16383.0, 65535.0)
"""Values of white in floating point: light, and samples of 8 to 16 bits."""
FEWEST_HOLES = 4
"""Fewest missing views that may be intended: the smallest such grids lack four corners, or four views of 3x3."""


class Samples(NamedTuple):
    """The chosen views of a light field as its file holds them."""

    colours: NDArray
    """uint8, uint16 or float32, [V, U, C, H, W] with C 1 or 3."""
    weight: NDArray | None
    """Trust in each sample, uint8, uint16 or float32, [V, U, 1, H, W]; None: 1 everywhere."""
    encoding: Encoding
    lens_views: Pair | None = None
    """Height and width of the lens in view steps, where some of its views were chosen; None: the grid."""


def split_weight(samples: NDArray, axis: int = -1) -> tuple[NDArray, NDArray | None]:
    """Colours, and the weight, which is the last of 2 or 4 channels along an axis."""
    n_channels = samples.shape[axis]
    if n_channels not in (2, 4):
        return samples, None
    colours, weight = np.split(samples, [n_channels - 1], axis)
    return colours, weight


@dataclass(frozen=True)
class ReadOptions:
    """Options as `lfref.read` describes them; `parse` checks them. `angular_size` and `grid` count as the file does."""

    angular_size: Cell | None = None
    start: int | None = None
    transpose: bool = False
    reverse_v: bool = False
    reverse_u: bool = False
    pattern: str | None = None
    lenslet: int | None = None
    pitch: Pair | None = None
    """Distance between rows, and between the lenslets of a row, in pixels."""
    offset: Pair | None = None
    rotation: float | None = None
    lattice: str | None = None
    calibration: Path | None = None
    size: Cell | None = None
    grid: Cell | None = None
    holes: bool | None = None
    axes: str | None = None
    variable: str | None = None
    positions: str | Path | None = None
    spacing: Pair | None = None
    value_range: Pair | None = None
    encoding: str = "file"

    @classmethod
    def parse(cls, **given: Any) -> "ReadOptions":
        """Options from the values that a user wrote; a pair may be a list, `angular_size` and `pitch` a number."""
        try:
            options: dict[str, Any] = {
                name: tuple(value) if isinstance(value, list) else value for name, value in given.items()
            }
            row_distance = ROW_DISTANCES[options.get("lattice") or "square"]
            if isinstance(pitch := options.get("pitch"), int | float):
                options["pitch"] = pitch * row_distance, pitch
            if isinstance(views := options.get("angular_size"), int):
                options["angular_size"] = views, views
            if options.get("transpose"):
                # Users count rows and columns of the light field, decoders those of the file.
                options |= {
                    name: options[name][::-1] for name in ("angular_size", "grid") if options.get(name) is not None
                }
            if options.get("calibration"):
                options["calibration"] = Path(options["calibration"])
            own = cls(**options)
            (_, _), (_, _), (black, white) = own.size or (1, 1), own.offset or (0, 0), own.value_range or (0, 1)
            least_pitch = min(own.pitch or (math.inf, math.inf))
            is_possible = least_pitch >= SHORTEST_PITCH * row_distance and abs(own.rotation or 0) <= 45
            is_possible &= own.lenslet is None or own.lenslet >= 1
            is_possible &= min(own.spacing or (1, 1)) > 0 and black < white
        except (KeyError, TypeError, ValueError, IndexError):
            is_possible = False
        if not is_possible:
            got = ", ".join(f"{name}={value!r}" for name, value in given.items() if value)
            raise InputError("options of the reader must be as lfref.read describes them", got=got)
        return own

    def window(self, grid: Sequence[int], path: Path, views: Cell | None = None) -> tuple[slice, slice]:
        """Rows and columns to keep of a grid in the file at `path`; `views` stands in for the option."""
        slices = []
        for n_views, count in zip(grid, views or self.angular_size or grid, strict=True):
            # Rounded up, so that 7 of 14 are views 4 to 10, whose centre 7 is the usual reference view.
            first = (n_views - count + 1) // 2 if self.start is None else self.start
            if count < 1 or first < 0 or first + count > n_views:
                got = f"views {count}, start {'in the middle' if self.start is None else first}"
                remedy, whole = "choose reader.angular_size and reader.start to fit", {"angular_size": tuple(grid)}
                expected = f"views to keep must be among the {n_views} of {path}"
                raise InputError(expected, got=got, remedy=remedy, proposals=[whole, whole | {"start": None}])
            slices.append(slice(first, first + count))
        return slices[0], slices[1]


def likely_range(colours: NDArray) -> Pair:
    """Values of black and white, as the extremes of samples suggest."""
    low, high = float(colours.min()), float(colours.max())
    if low < 0:
        return (-1.0, 1.0) if low >= -1.05 and high <= 1.05 else (low, high)
    return 0.0, next((white for white in WHITES if high <= white), high)


def grids_of(count: int) -> list[dict[str, Any]]:
    """Options for grids of so many views, the squarest first, those with more columns than rows before others."""
    sides = [rows for rows in range(math.isqrt(count), 0, -1) if count % rows == 0]
    return [{"grid": grid} for rows in sides for grid in ((rows, count // rows), (count // rows, rows))]


def extent(cells: Iterable[Cell]) -> Cell:
    """Rows and columns of the smallest grid with these cells."""
    rows, columns = zip(*cells, strict=True)
    return 1 + max(rows), 1 + max(columns)


def cell_of(number: int, n_columns: int, is_serpentine: bool = False) -> Cell:
    """The cell of a view by its number, row by row; on a serpentine path every second row runs to the left."""
    row, column = divmod(number, n_columns)
    return row, n_columns - 1 - column if is_serpentine and row % 2 else column


def check_holes(cells: Iterable[Cell], shape: Cell, path: Path, allowed: bool | None) -> None:
    """Refuse a grid whose views are missing by accident, unless holes are `allowed`; None: if they seem intended.

    Intended are crosses, diagonals, grids without corners: the same after half a turn, as hardly any incomplete copy.
    """
    (rows, columns), present = shape, set(cells)
    n_holes = rows * columns - len(present)
    # A stray file name may imply billions of views.
    is_plausible = max(shape) <= 4 * len(present)
    turned = {(rows - 1 - row, columns - 1 - column) for row, column in present}
    is_on_purpose = n_holes >= FEWEST_HOLES and present == turned
    if n_holes and not (is_plausible and (allowed or (allowed is None and is_on_purpose))):
        row, column = next(divmod(n, columns) for n in range(rows * columns) if divmod(n, columns) not in present)
        expected = f"{path} must hold a view for each row and column"
        got = f"none in row {row}, column {column} ({n_holes} of {rows * columns} missing)"
        raise FileError(expected, got=got, remedy="add them", proposals=[{"holes": True}])


def gather(
    cells: Mapping[Cell, Source], window: tuple[slice, slice], load: Callable[[Source], NDArray]
) -> tuple[NDArray, NDArray | None]:
    """Colours [V, U, C, H, W] and weight of the views in a window, each loaded as [H, W, C]; 0 where one is missing."""
    shape = window[0].stop - window[0].start, window[1].stop - window[1].start
    is_present = np.zeros(shape, bool)
    whole = np.zeros(0)
    for row, column in np.ndindex(shape):
        if (source := cells.get((row + window[0].start, column + window[1].start))) is None:
            continue
        view = load(source)
        if not is_present.any():
            whole = np.zeros((*shape, *view.shape), view.dtype)
        if (view.shape, view.dtype) != (whole.shape[2:], whole.dtype):
            got = f"{view.shape} of {view.dtype} after {whole.shape[2:]} of {whole.dtype}"
            raise FileError(f"{source} must be like the views before it", got=got, remedy="all views must be alike")
        whole[row, column], is_present[row, column] = view, True
    if not is_present.any():
        expected = f"the {shape[0]}x{shape[1]} views to keep must be there"
        raise FileError(expected, got="none", remedy="set reader.angular_size")
    colours, weight = split_weight(whole.transpose(0, 1, 4, 2, 3), axis=2)
    if not is_present.all():
        if weight is None:
            weight = np.zeros_like(colours[:, :, :1])
            weight[is_present] = np.iinfo(colours.dtype).max if colours.dtype.kind == "u" else 1
        # Results exclude the mean by its weight 0; it only keeps black from divisions and from filters without weights.
        mean = colours[is_present].mean(axis=0, dtype=np.float64)
        colours[~is_present] = np.rint(mean) if colours.dtype.kind == "u" else mean
    return colours, weight


def check_memory(n_bytes: float, what: str) -> None:
    """Refuse work that needs more memory than this process can get; Linux would kill it halfway, without a message."""
    limit = math.inf
    with suppress(OSError, TypeError):  # not on Linux
        entry = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
        limit = int(entry[1]) * 1024  # type: ignore[index]
    with suppress(OSError, ValueError):  # no container
        folder = Path("/sys/fs/cgroup")
        used = int((folder / "memory.current").read_text())
        limit = min(limit, int((folder / "memory.max").read_text()) - used)
    if n_bytes > limit:
        got = f"{n_bytes / 1e9:.1f} GB for {limit / 1e9:.1f} GB"
        raise InputError(f"{what} must fit into memory", got=got, remedy="set reader.angular_size or reader.size")
