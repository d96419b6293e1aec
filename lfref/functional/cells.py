"""How much of each cell of a grid a figure covers."""

import torch
from torch import Tensor

STRIPS = 4096  # that a disc is cut into: the areas are exact to 1e-6 of its own


def of_disc(rows: Tensor, columns: Tensor, radius: float = 1.0) -> Tensor:
    """Area of each cell that a disc about 0 covers.

    Args:
        rows: Edges of the rows of cells, rising, float64, [J + 1].
        columns: Edges of the columns, likewise, [I + 1].
        radius: Of the disc.

    Returns:
        Float64, [J, I].
    """
    # Strips that are narrow where the edge runs along them.
    strips = -radius * torch.linspace(0, torch.pi, STRIPS + 1, dtype=torch.float64).cos()
    half_chord = (radius**2 - ((strips[1:] + strips[:-1]) / 2).square()).sqrt()
    return overlap(strips[:-1], strips[1:], rows).T @ overlap(-half_chord, half_chord, columns)


def overlap(start: Tensor, stop: Tensor, edges: Tensor) -> Tensor:
    """Length that each interval shares with each cell along one axis.

    Args:
        start: Of the intervals, [S].
        stop: Likewise, [S].
        edges: Of the cells, rising, [I + 1].

    Returns:
        [S, I].
    """
    low, high = torch.maximum(start[:, None], edges[:-1]), torch.minimum(stop[:, None], edges[1:])
    return (high - low).clamp(min=0)
