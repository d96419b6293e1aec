"""How much of each cell of a grid a figure covers: the weights of views under an aperture."""

import math

import torch
from torch import Tensor

STRIPS = 4096
"""Strips that a figure is cut into: areas are exact to 1e-6 of the figure."""


def of_disc(rows: Tensor, columns: Tensor, radius: float = 1.0) -> Tensor:
    """How much of the area of each cell a disc about 0 covers.

    Args:
        rows: Edges of the rows of cells, rising, float64, [J + 1].
        columns: Edges of the columns of cells, rising, float64, [I + 1].
        radius: Of the disc.

    Returns:
        Float64, [J, I].
    """
    # Strips along the columns; narrow where the edge runs along them.
    strips = -radius * torch.linspace(0, torch.pi, STRIPS + 1, dtype=torch.float64).cos()
    half_chord = (radius**2 - ((strips[1:] + strips[:-1]) / 2).square()).sqrt()
    return overlap(strips[:-1], strips[1:], rows).T @ overlap(-half_chord, half_chord, columns)


def of_polygon(rows: Tensor, columns: Tensor, n_corners: int, radius: float = 1.0, turn: float = 0.0) -> Tensor:
    """How much of the area of each cell a regular polygon about 0 covers.

    Args:
        rows: Edges of the rows of cells, rising, float64, [J + 1].
        columns: Edges of the columns of cells, rising, float64, [I + 1].
        n_corners: At least 3.
        radius: Of the circle through the corners.
        turn: Angle of one corner, from the columns' axis towards the rows', in radians.

    Returns:
        Float64, [J, I].
    """
    heights = [radius * math.sin(turn + 2 * corner * math.pi / n_corners) for corner in range(n_corners)]
    strips = torch.linspace(min(heights), max(heights), STRIPS + 1, dtype=torch.float64)
    middles = (strips[1:] + strips[:-1]) / 2
    left, right = torch.full_like(middles, -radius), torch.full_like(middles, radius)
    for side in range(n_corners):
        # Inside of a side are the points p with p.(across, down) <= near.
        angle = turn + (2 * side + 1) * math.pi / n_corners
        across, down, near = math.cos(angle), math.sin(angle), radius * math.cos(math.pi / n_corners)
        # A side along the columns bounds no strip; dividing by a tiny number of the right sign puts its end far away.
        end = (near - down * middles) / (across if abs(across) > 1e-12 else math.copysign(1e-12, across))
        left, right = (left, right.minimum(end)) if across > 0 else (left.maximum(end), right)
    return overlap(strips[:-1], strips[1:], rows).T @ overlap(left, right, columns)


def overlap(start: Tensor, stop: Tensor, edges: Tensor) -> Tensor:
    """Length that each interval (`start` to `stop`, [S]) shares with each cell between rising edges [I + 1]; [S, I]."""
    low, high = torch.maximum(start[:, None], edges[:-1]), torch.minimum(stop[:, None], edges[1:])
    return (high - low).clamp(min=0)
