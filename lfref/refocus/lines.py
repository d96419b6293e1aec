"""Positions of the cameras as what a shift separates into: lines of views, each at one height.

An even grid has its rows, all with the same columns. Cameras elsewhere are lines if each row of them stands at one
height; otherwise every view is a line of its own.
Letters: `v u` camera position downwards and to the right, in view steps; `R` lines, `M` views of each.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import Slopes


class Lines(NamedTuple):
    """Positions of the views from the angular centre, in view steps, float64, CPU."""

    rows: Tensor
    """v of each line, [R]."""
    columns: Tensor
    """u of the views of each line, [R, M]; [1, M] if that of all lines is the same."""

    @property
    def shape(self) -> tuple[int, int]:
        """(R, M), what views [V, U, ...] are reshaped to."""
        return len(self.rows), self.columns.shape[1]

    @property
    def extent(self) -> tuple[float, float]:
        """The even grid (V, U) that reaches as far, which need not be whole."""
        rows, columns = (1 + 2 * float(offsets.abs().max()) for offsets in self)
        return rows, columns


def lines(grid: tuple[int, int], positions: Tensor | None = None) -> Lines:
    """The lines of cameras of a grid (V, U), at positions [V, U, 2] or, without any, evenly spaced."""
    if positions is None:
        return Lines(geometry.angular_offsets(grid[0]), geometry.angular_offsets(grid[1])[None])
    v, u = checked_positions(positions, grid).unbind(-1)
    if not bool((v == v[:, :1]).all()):
        return Lines(v.flatten(), u.reshape(-1, 1))
    return Lines(v[:, 0], u[:1] if bool((u == u[:1]).all()) else u)


def even(grid: tuple[int, int]) -> Tensor:
    """(v, u) of each camera of an even grid (V, U) from its centre, in view steps, float64, [V, U, 2]."""
    return torch.stack(torch.meshgrid(*map(geometry.angular_offsets, grid), indexing="ij"), -1)


def checked_positions(positions: Tensor, grid: tuple[int, int]) -> Tensor:
    """The positions as float64 on the CPU, [V, U, 2].

    Raises:
        InputError: Another shape, or a position that is not finite.
    """
    values = torch.as_tensor(positions, dtype=torch.float64, device="cpu").detach()
    if tuple(values.shape) != (*grid, 2):
        raise InputError(f"positions must be {[*grid, 2]}, (v, u) of each view", got=f"shape {list(values.shape)}")
    if not bool(values.isfinite().all()):
        raise InputError("positions must be finite, in view steps", got="NaN or infinity")
    return values


def checked_slopes(slopes: Slopes, grid: tuple[int, int], size: tuple[int, int], positions: Tensor | None) -> Tensor:
    """As `geometry.checked_slopes`, for cameras anywhere."""
    return geometry.checked_slopes(slopes, lines(grid, positions).extent, size)
