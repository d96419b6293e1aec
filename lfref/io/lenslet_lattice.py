"""The lattice of lenslets in front of a sensor, and views sampled from it between the pixels.

A lattice tells where each lenslet stands in pixels of the lenslet image; sampling brings any lattice onto a square one.
Letters: `V U` view rows and columns, `C` channels, `i j` row and column of a lenslet, `y x` of a pixel (whole numbers
at the centres). Interpolation is cubic convolution.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import embedding_bag

from lfref.functional import splines
from lfref.io.samples import Pair

SAME_PITCH = 0.01
"""Largest relative difference of the pitch in an image from what an option or a record says of it."""


@dataclass(frozen=True)
class Lattice:
    """Lenslets in rows; those of a hexagonal lattice are half a step further in every other row."""

    origin: Pair
    """Centre (y, x) of lenslet (0, 0), in pixels."""
    rows: Pair
    """Step (y, x) from one row of lenslets to the next, in pixels, without the half step of a hexagonal lattice."""
    columns: Pair
    """Step (y, x) from one lenslet to the next of its row, in pixels."""
    is_hexagonal: bool = False
    """Whether every other row stands half a step further along its columns."""

    @property
    def pitch(self) -> Pair:
        """Distance between rows, and between the lenslets of a row, in pixels."""
        return math.hypot(*self.rows), math.hypot(*self.columns)

    @property
    def rotation(self) -> float:
        """Angle of the rows in degrees, above 0 if they fall to the right."""
        return math.degrees(math.atan2(*self.columns))

    def agrees_with(self, other: "Lattice") -> bool:
        """Whether two lattices are of the same kind, and their pitches equal up to `SAME_PITCH`."""
        pitches = zip(self.pitch, other.pitch, strict=True)
        return self.is_hexagonal == other.is_hexagonal and all(abs(a / b - 1) < SAME_PITCH for a, b in pitches)

    @property
    def name(self) -> str:
        """The value of the option `lattice`: `hexagonal` or `square`."""
        return "hexagonal" if self.is_hexagonal else "square"

    def centres(self, i: NDArray, j: NDArray) -> tuple[NDArray, NDArray]:
        """Centres `y` and `x` in pixels, float64, of the lenslets in rows `i` and columns `j`, which broadcast."""
        along = j + (i % 2) / 2 if self.is_hexagonal else np.asarray(j)
        y, x = (self.origin[k] + i * self.rows[k] + along * self.columns[k] for k in (0, 1))
        return y, x

    def nearest(self, y: NDArray, x: NDArray) -> tuple[NDArray, NDArray]:
        """Row and column of the lenslet nearest to each place, in pixels; `y` and `x` broadcast."""
        inverse = np.linalg.inv([self.rows, self.columns])
        row, along = (inverse[0, k] * (y - self.origin[0]) + inverse[1, k] * (x - self.origin[1]) for k in (0, 1))
        numbers, distances = [], []
        for i in (np.floor(row), np.floor(row) + 1):
            j = np.rint(along - (i % 2) / 2 * self.is_hexagonal)
            centre_y, centre_x = self.centres(i, j)
            numbers.append((i, j))
            distances.append((centre_y - y) ** 2 + (centre_x - x) ** 2)
        is_second = distances[1] < distances[0]
        return np.where(is_second, numbers[1][0], numbers[0][0]), np.where(is_second, numbers[1][1], numbers[0][1])

    def steps(self) -> tuple[Pair, Pair]:
        """The directions (y, x) of `v` (from row to row) and of `u` (along a row), one pixel long."""
        (row_y, row_x), (column_y, column_x), (down, along) = self.rows, self.columns, self.pitch
        return (row_y / down, row_x / down), (column_y / along, column_x / along)

    def within(self, size: tuple[int, int], reach: Pair) -> tuple[range, range]:
        """Rows and columns of a block of lenslets that reach so far (y, x) from their centres and lie in a picture."""
        i, j = self.numbers_around(size)
        y, x = self.centres(i[:, None], j[None, :])
        # Twice the distance from the picture's middle; the millionth of a pixel allows for rounding.
        inside = abs(2 * y - size[0] + 1) <= size[0] - 2 * reach[0] - 1 + 1e-6
        inside &= abs(2 * x - size[1] + 1) <= size[1] - 2 * reach[1] - 1 + 1e-6
        top, bottom, left, right = 0, len(i), 0, len(j)
        # The side with the largest share outside gives way first: a lattice that is hardly turned loses few lenslets.
        while top < bottom and left < right and not (block := inside[top:bottom, left:right]).all():
            worst = int(np.argmin([edge.mean() for edge in (block[0], block[-1], block[:, 0], block[:, -1])]))
            top, bottom = top + (worst == 0), bottom - (worst == 1)
            left, right = left + (worst == 2), right - (worst == 3)
        return range(i[0] + top, i[0] + max(top, bottom)), range(j[0] + left, j[0] + max(left, right))

    def numbers_around(self, size: tuple[int, int]) -> tuple[NDArray, NDArray]:
        """Numbers of all rows and columns that may lie in a picture, and some beyond."""
        steps = np.array([self.rows, self.columns]).T
        corners = np.array([(y, x) for y in (0, size[0]) for x in (0, size[1])]) - self.origin
        numbers = np.linalg.solve(steps, corners.T)
        (i_first, j_first), (i_last, j_last) = numbers.min(axis=1) - 1, numbers.max(axis=1) + 2
        return np.arange(int(i_first), int(i_last)), np.arange(int(j_first), int(j_last))


def upright(pitch: Pair, offset: Pair, rotation: float = 0.0, is_hexagonal: bool = False) -> Lattice:
    """A lattice whose steps along and between rows are at a right angle; `offset` is its origin."""
    cosine, sine = math.cos(math.radians(rotation)), math.sin(math.radians(rotation))
    rows = pitch[0] * cosine, -pitch[0] * sine
    return Lattice(offset, rows, (pitch[1] * sine, pitch[1] * cosine), is_hexagonal)


TAPS = 4
ASPECT = 0.002
"""Relative difference of row and column distances below which pixels count as square: a pixel in 500."""


def n_views(pitch: float) -> int:
    """Number of views along an axis of a lenslet, for a pitch of at least 2 pixels."""
    whole = math.floor(pitch)
    # The middle one of an odd number of views looks through the centres of the lenslets.
    return whole if whole == pitch else whole - 1 + whole % 2


def sample_views(image: NDArray, lattice: Lattice, grid: tuple[int, int], window: tuple[slice, slice]) -> NDArray:
    """Views in a window of the grid, float32, [V, U, C, H', W'], of linear light [H, W, C]; empty if none fits."""
    reach = (grid[0] - 1) / 2, (grid[1] - 1) / 2
    i, j = (np.array(numbers, dtype=int) for numbers in lattice.within(image.shape[:2], reach))
    y, x = lattice.centres(i[:, None], j[None, :])
    (v_y, v_x), (u_y, u_x) = lattice.steps()
    padded = np.pad(np.asarray(image, np.float32), ((1, 3), (1, 3), (0, 0)), mode="edge")
    views = np.empty((*(len(range(grid[k])[window[k]]) for k in (0, 1)), image.shape[2], *y.shape), np.float32)
    for v, u in np.ndindex(views.shape[:2]):
        down, right = window[0].start + v - reach[0], window[1].start + u - reach[1]
        samples = interpolate(padded, y + down * v_y + right * u_y, x + down * v_x + right * u_x)
        views[v, u] = samples.transpose(2, 0, 1)
    return squared(views, lattice, i)


def interpolate(padded: NDArray[np.float32], y: NDArray, x: NDArray) -> NDArray[np.float32]:
    """Samples [I, J, C] at rows `y` and columns `x` of a picture, which is padded by 1 pixel before and 3 behind."""
    (top, down), (left, right) = _split(y, padded.shape[0] - 4), _split(x, padded.shape[1] - 4)
    width = padded.shape[1]
    nearby = np.add.outer(np.arange(TAPS) * width, np.arange(TAPS)).ravel()
    pixels = np.add.outer((top * width + left).ravel(), nearby)
    weights = (_taps(right) * _taps(down)[:, None]).reshape(TAPS * TAPS, -1).T
    # `embedding_bag` sums weighted rows of a table: 16 pixels for each sample.
    samples = embedding_bag(
        torch.from_numpy(pixels),
        torch.from_numpy(padded.reshape(-1, padded.shape[2])),
        mode="sum",
        per_sample_weights=torch.from_numpy(np.ascontiguousarray(weights)),
    )
    return samples.numpy().reshape(*y.shape, padded.shape[2])


def _split(positions: NDArray, length: int) -> tuple[NDArray[np.intp], NDArray]:
    """Whole pixels and fractions of positions; positions that rounding moved out of the picture are moved back."""
    kept = positions.clip(0, length - 1)
    whole = np.floor(kept).astype(np.intp)
    return whole, kept - whole


def _taps(t: NDArray) -> NDArray[np.float32]:
    """Weights of the samples at -1, 0, 1 and 2 for positions t in [0, 1), [4, ...]."""
    return torch.stack(splines.weights(torch.from_numpy(t))).float().numpy()


def squared(views: NDArray[np.float32], lattice: Lattice, i: NDArray) -> NDArray[np.float32]:
    """Views [..., I, W'], whose pixels are as far apart as the rows, from views [..., I, J] of the lenslet rows `i`."""
    pitch = lattice.pitch
    if not lattice.is_hexagonal and abs(pitch[0] / pitch[1] - 1) < ASPECT:
        return views
    late = (i % 2) / 2 * lattice.is_hexagonal
    last = views.shape[-1] - 1 + late.min(initial=0)
    columns = np.arange(late.max(initial=0), last + 1e-9, pitch[0] / pitch[1])
    # Rows continue in a straight line beyond their ends, so that gradients do not end in a step.
    ends = [(0, 0)] * (views.ndim - 1) + [(1, 2)]
    padded = np.pad(views, ends, mode="reflect", reflect_type="odd") if len(i) else views
    rows = []
    for k in range(len(i)):
        whole, t = _split(columns - late[k], views.shape[-1])
        weights = _taps(t)
        row = padded[..., k, :]
        rows.append(np.sum([weights[n] * row[..., whole + n] for n in range(TAPS)], axis=0, dtype=np.float32))
    return np.stack(rows, axis=-2) if rows else views
