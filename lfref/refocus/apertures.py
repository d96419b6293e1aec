"""Synthetic apertures: how much each view counts, as weights [V, U] that every operator takes.

Sizes are in view steps and every view owns a cell of 1 x 1, so that seven views span a diameter of 7. A view that
the edge of an aperture crosses counts by the share of its cell that the aperture covers. Operators divide by the sum.
Every function takes the `grid` (V, U) of view rows and columns and returns weights, float64, [V, U]; parts of an
aperture beyond the grid are lost. Sizes that are not finite or not above 0 are an InputError.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.refocus import batches


def full(grid: Sequence[int]) -> Tensor:
    """All views alike."""
    return torch.ones(tuple(grid), dtype=torch.float64)


def disc(grid: Sequence[int], diameter: float | None = None) -> Tensor:
    """A round aperture about the angular centre, `diameter` view steps wide; None: the largest on the grid."""
    radius = _checked("diameter", min(grid) if diameter is None else diameter) / 2
    return geometry.covered_by_disc(_edges(grid[0]), _edges(grid[1]), radius)


def square(grid: Sequence[int], side: float | None = None) -> Tensor:
    """A square aperture about the angular centre, with sides of `side` view steps; None: the largest on the grid."""
    half = torch.tensor([_checked("side", min(grid) if side is None else side) / 2], dtype=torch.float64)
    rows, columns = (geometry.overlap(-half, half, _edges(n_views)) for n_views in grid)
    return rows.T * columns


def polygon(grid: Sequence[int], blades: int, diameter: float | None = None, rotation: float = 0.0) -> Tensor:
    """A regular polygon about the angular centre: the opening between the blades of a diaphragm.

    Args:
        blades: Corners, >= 3.
        diameter: Of the circle through the corners, in view steps; None: the largest on the grid.
        rotation: Angle of one corner, clockwise from the right, in degrees, finite.
    """
    if not (isinstance(blades, int) and blades >= 3):
        raise InputError("blades must be a whole number of at least 3", got=repr(blades))
    radius = _checked("diameter", min(grid) if diameter is None else diameter) / 2
    return geometry.covered_by_polygon(_edges(grid[0]), _edges(grid[1]), blades, radius, math.radians(rotation))


def gaussian(grid: Sequence[int], sigma: float) -> Tensor:
    """An aperture that fades out from the angular centre as exp(-r^2 / (2 sigma^2)), of sum 1; sigma in view steps."""
    width = _checked("sigma", sigma)
    rows, columns = ((-(geometry.angular_offsets(n_views) / width).square() / 2).softmax(0) for n_views in grid)
    return rows[:, None] * columns


def mask(grid: Sequence[int], rows: Sequence[Sequence[float]] | Tensor) -> Tensor:
    """Any aperture: the weight of each view, finite, >= 0 and not all zero, one list for each view row, [V, U]."""
    weights = torch.as_tensor(rows, dtype=torch.float64, device="cpu")
    batches.checked_weights(weights, (grid[0], grid[1]))
    return weights


def _edges(n_views: int) -> Tensor:
    """Where cells about the centre begin and end along one axis, in their widths, [n_views + 1]."""
    return torch.arange(n_views + 1, dtype=torch.float64) - n_views / 2


def _checked(name: str, size: float) -> float:
    if not (math.isfinite(size) and size > 0):
        raise InputError(f"{name} must be finite and above 0, in view steps", got=size)
    return float(size)
