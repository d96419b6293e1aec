"""Views read out of a lenslet image between its pixels, and lenslets of any lattice brought onto a square one.

Letters: `V U` view rows and columns, `C` channels, `i j` row and column of a lenslet, `y x` of a pixel. Between pixels
a cubic is read (Keys, "Cubic convolution interpolation for digital image processing", 1981).
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import embedding_bag

# PART lattice
# The lattice of lenslets in front of a sensor: where each one stands, in pixels of the lenslet image.
#
# Letters: `i j` row and column of a lenslet, `y x` pixel row and column, whole numbers at the centres of pixels.

Pair = tuple[float, float]
"""Of rows and columns, or (y, x) in pixels."""

HEXAGONAL_ROWS = math.sqrt(3) / 2
"""Distance of the rows of a hexagonal lattice, in distances between neighbours."""


@dataclass(frozen=True)
class Lattice:
    """Lenslets in rows; those of a hexagonal lattice are half a step further in every other row.

    Example:
        >>> lattice = upright((14.0, 14.0), (6.5, 6.5), rotation=0.3)
        >>> lattice.pitch, round(lattice.rotation, 6)
        ((14.0, 14.0), 0.3)
    """

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
        """Distance of rows, and of the lenslets of a row, in pixels."""
        return math.hypot(*self.rows), math.hypot(*self.columns)

    @property
    def rotation(self) -> float:
        """Degrees by which rows are turned, above 0 where they fall to the right."""
        return math.degrees(math.atan2(*self.columns))

    @property
    def name(self) -> str:
        """As the option `lattice` calls it."""
        return "hexagonal" if self.is_hexagonal else "square"

    def centres(self, i: NDArray, j: NDArray) -> tuple[NDArray, NDArray]:
        """Where lenslets stand.

        Args:
            i: Rows, whole numbers, any shape.
            j: Columns, likewise.

        Returns:
            `y` and `x` in pixels, float64, of their common shape.
        """
        along = j + (i % 2) / 2 if self.is_hexagonal else np.asarray(j)
        y, x = (self.origin[k] + i * self.rows[k] + along * self.columns[k] for k in (0, 1))
        return y, x

    def steps(self) -> tuple[Pair, Pair]:
        """One pixel (y, x) along the rows' succession, and one along a row: the directions of `v` and `u`."""
        pitch = self.pitch
        return (self.rows[0] / pitch[0], self.rows[1] / pitch[0]), (
            self.columns[0] / pitch[1],
            self.columns[1] / pitch[1],
        )

    def within(self, size: tuple[int, int], reach: Pair) -> tuple[range, range]:
        """A block of lenslets that lie wholly in a picture, as large as may be.

        Args:
            size: Height and width of the picture, in pixels.
            reach: How far a lenslet extends from its centre along `y` and `x`, in pixels.

        Returns:
            Rows and columns of lenslets; either is empty where there is no room.
        """
        i, j = self.candidates(size)
        y, x = self.centres(i[:, None], j[None, :])
        inside = (abs(2 * y - size[0] + 1) <= size[0] - 2 * reach[0] - 1 + 1e-6) & (
            abs(2 * x - size[1] + 1) <= size[1] - 2 * reach[1] - 1 + 1e-6
        )
        top, bottom, left, right = _block(inside)
        return range(i[0] + top, i[0] + bottom), range(j[0] + left, j[0] + right)

    def candidates(self, size: tuple[int, int]) -> tuple[NDArray, NDArray]:
        """Rows and columns that may lie in a picture: all of those that its corners lie between."""
        steps = np.array([self.rows, self.columns]).T
        corners = np.array([(y, x) for y in (0, size[0]) for x in (0, size[1])]) - self.origin
        numbers = np.linalg.solve(steps, corners.T)
        (i_first, j_first), (i_last, j_last) = numbers.min(axis=1) - 1, numbers.max(axis=1) + 2
        return np.arange(int(i_first), int(i_last)), np.arange(int(j_first), int(j_last))


def upright(pitch: Pair, offset: Pair, rotation: float = 0.0, is_hexagonal: bool = False) -> Lattice:
    """The lattice whose rows stand at a right angle to their succession.

    Args:
        pitch: Distance of rows, and of the lenslets of a row, in pixels, above 0.
        offset: Centre (y, x) of one lenslet, in pixels.
        rotation: Degrees by which rows are turned, above 0 where they fall to the right.
        is_hexagonal: Whether every other row stands half a step further.
    """
    cosine, sine = math.cos(math.radians(rotation)), math.sin(math.radians(rotation))
    rows = pitch[0] * cosine, -pitch[0] * sine
    return Lattice(offset, rows, (pitch[1] * sine, pitch[1] * cosine), is_hexagonal)


def _block(inside: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """First row, end of rows, first column, end of columns of a block that is inside throughout.

    The side with the largest share outside gives way first: a lattice that is hardly turned loses few lenslets.
    """
    top, bottom, left, right = 0, inside.shape[0], 0, inside.shape[1]
    while top < bottom and left < right and not (block := inside[top:bottom, left:right]).all():
        shares = [edge.mean() for edge in (block[0], block[-1], block[:, 0], block[:, -1])]
        worst = int(np.argmin(shares))
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return top, max(top, bottom), left, max(left, right)


TAPS = 4
ASPECT = 0.002
"""By how much, relatively, the distances of rows and columns may differ before columns are resampled."""


def n_views(pitch: float) -> int:
    """How many views fit in a lenslet.

    Args:
        pitch: Of the lenslets, in pixels, at least 1.

    Returns:
        The pitch itself where it is whole: pixels are views then; else the largest odd number, whose middle view looks
        through the centres of the lenslets.
    """
    whole = math.floor(pitch)
    return whole if whole == pitch else whole - 1 + whole % 2


def read_views(image: NDArray, lattice: Lattice, grid: tuple[int, int], window: tuple[slice, slice]) -> NDArray:
    """The views of a lenslet image.

    Args:
        image: Linear light, floating point, [H, W, C].
        lattice: Where the lenslets stand.
        grid: Rows and columns of views that a lenslet has.
        window: Which of them to read.

    Returns:
        Views, float32, one pixel a lenslet; pixels are square, [V, U, C, H', W'], H' or W' 0 where no lenslet lies
        wholly in the image.
    """
    reach = (grid[0] - 1) / 2, (grid[1] - 1) / 2
    i, j = (np.array(numbers, dtype=int) for numbers in lattice.within(image.shape[:2], reach))
    y, x = lattice.centres(i[:, None], j[None, :])
    (v_y, v_x), (u_y, u_x) = lattice.steps()
    padded = np.pad(np.asarray(image, np.float32), ((1, 3), (1, 3), (0, 0)), mode="edge")
    views = np.empty((*(len(range(grid[k])[window[k]]) for k in (0, 1)), image.shape[2], *y.shape), np.float32)
    for v, u in np.ndindex(views.shape[:2]):
        down, right = window[0].start + v - reach[0], window[1].start + u - reach[1]
        one = between(padded, y + down * v_y + right * u_y, x + down * v_x + right * u_x)
        views[v, u] = one.transpose(2, 0, 1)
    return squared(views, lattice, i)


def between(padded: NDArray[np.float32], y: NDArray, x: NDArray) -> NDArray[np.float32]:
    """A picture between its pixels.

    Args:
        padded: The picture with 1 pixel more above and on the left, 3 below and on the right, [H + 4, W + 4, C].
        y: Rows in the picture itself, in [0, H - 1] but for rounding, [I, J].
        x: Columns, likewise.

    Returns:
        Samples, [I, J, C].
    """
    (top, down), (left, right) = _split(y, padded.shape[0] - 4), _split(x, padded.shape[1] - 4)
    width = padded.shape[1]
    nearby = np.add.outer(np.arange(TAPS) * width, np.arange(TAPS)).ravel()
    pixels = np.add.outer((top * width + left).ravel(), nearby)
    weights = (taps(right) * taps(down)[:, None]).reshape(TAPS * TAPS, -1).T
    # PyTorch's name for weighted sums of a few rows of a table: the pixels, 16 a sample.
    samples = embedding_bag(
        torch.from_numpy(pixels),
        torch.from_numpy(padded.reshape(-1, padded.shape[2])),
        mode="sum",
        per_sample_weights=torch.from_numpy(np.ascontiguousarray(weights)),
    )
    return samples.numpy().reshape(*y.shape, padded.shape[2])


def _split(positions: NDArray, length: int) -> tuple[NDArray[np.intp], NDArray]:
    """Whole pixels, and what is left; positions that rounding took out of the picture are put back."""
    kept = positions.clip(0, length - 1)
    whole = np.floor(kept).astype(np.intp)
    return whole, kept - whole


def taps(t: NDArray) -> NDArray[np.float32]:
    """Weights of the samples at -1, 0, 1 and 2 for positions t in [0, 1).

    Args:
        t: Any shape.

    Returns:
        Weights, [4, ...].
    """
    weights = (
        t * (-0.5 + t * (1 - 0.5 * t)),
        1 + t * t * (1.5 * t - 2.5),
        t * (0.5 + t * (2 - 1.5 * t)),
        t * t * (0.5 * t - 0.5),
    )
    return np.stack(weights).astype(np.float32)


def squared(views: NDArray[np.float32], lattice: Lattice, i: NDArray) -> NDArray[np.float32]:
    """Views with square pixels: rows of lenslets are resampled at the distance of the rows from each other.

    Args:
        views: One sample a lenslet, [..., I, J].
        lattice: Where the lenslets stand.
        i: Numbers of their rows, [I].

    Returns:
        Views, [..., I, W']; as they are where they already are square and no row stands half a step further.
    """
    pitch = lattice.pitch
    if not lattice.is_hexagonal and abs(pitch[0] / pitch[1] - 1) < ASPECT:
        return views
    late = (i % 2) / 2 * lattice.is_hexagonal
    last = views.shape[-1] - 1 + late.min(initial=0)
    places = np.arange(late.max(initial=0), last + 1e-9, pitch[0] / pitch[1])
    resampled = [_row(views[..., k, :], places - late[k]) for k in range(len(i))]
    return np.stack(resampled, axis=-2) if resampled else views


def _row(samples: NDArray[np.float32], positions: NDArray) -> NDArray[np.float32]:
    """Samples of a row between its lenslets, [..., J] -> [..., W']."""
    whole, t = _split(positions, samples.shape[-1])
    weights = taps(t)
    ends = [(0, 0)] * (samples.ndim - 1) + [(1, 2)]
    # Straight on beyond the ends, so that slopes do not end in a step.
    padded = np.pad(samples, ends, mode="reflect", reflect_type="odd")
    return np.sum([weights[k] * padded[..., whole + k] for k in range(TAPS)], axis=0, dtype=np.float32)
