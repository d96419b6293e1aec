"""Where each view shows what is at a pixel of the picture: the one thing that surfaces and homographies differ in.

Letters: `u v` view column and row, `x y w` homogeneous pixel.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref.refocus import lines

Positions = tuple[Tensor, Tensor, Tensor | bool]
"""x and y in a view, in pixels, and where the view can see the point at all, [H, W] each."""


class Places(NamedTuple):
    """At matrix (x, y, 1), then moved by slope times the view's offset from the middle of the grid."""

    matrices: Tensor | None = None
    """From pixels of the picture to those of each view, float64, [V, U, 3, 3]; None: the same pixel."""
    slopes: Tensor | None = None
    """At each pixel, in pixels per view step, float64, [H, W]; None: 0."""
    positions: Tensor | None = None
    """(v, u) of each view from the middle of the grid, in view steps, float64, CPU, [V, U, 2]; None: an even grid."""

    @property
    def tensors(self) -> list[Tensor]:
        """Those that are given and may be differentiated."""
        return [tensor for tensor in (self.matrices, self.slopes) if tensor is not None]

    def offsets(self, grid: tuple[int, int]) -> Tensor:
        """The positions, of an even grid (V, U) where none are given."""
        return lines.even(grid) if self.positions is None else self.positions

    def seen_from(self, v: int, u: int, offset: tuple[float, float], x: Tensor, y: Tensor) -> Positions:
        """Where a view shows pixels.

        Args:
            v: View row.
            u: View column.
            offset: Of that view from the middle of the grid, downwards and to the right, in view steps.
            x: Columns, float64, [1, W].
            y: Rows, float64, [H, 1].
        """
        visible: Tensor | bool = True
        if self.matrices is not None:
            x, y, w = (row[0] * x + row[1] * y + row[2] for row in self.matrices[v, u])
            visible = in_front = w > 0
            # Divided by 1 instead of 0 behind the camera: those are left out, but NaN would reach the gradients.
            w = torch.where(in_front, w, 1.0)
            x, y = x / w, y / w
        if self.slopes is not None:
            x, y = x + self.slopes * offset[1], y + self.slopes * offset[0]
        return x, y, visible


def pixels(views: Tensor) -> tuple[Tensor, Tensor]:
    """Columns x [1, W] and rows y [H, 1] of the picture, in pixels, float64.

    Args:
        views: Anything [..., H, W].
    """
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in views.shape[-2:])
    return columns[None], rows[:, None]
