"""The lattice of lenslets in front of a sensor: where each one stands, in pixels of the lenslet image.

Letters: `i j` row and column of a lenslet, `y x` pixel row and column, whole numbers at the centres of pixels.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
