"""Apertures with an area: each view stands for a cell of the aperture, `fill` view steps wide, instead of a point.

Within the cell light of disparity d moves by |s - d| pixels a view step, so that a plane is the sum of points blurred
by a box of `fill |s - d|` pixels along x and along y. It is the same for all views: a filter of the finished plane.
Letters: `s` slope and `d` disparity in pixels per view step.
Sources: Isaksen et al., "Dynamically reparameterized light fields", 2000; Stewart et al., "A new reconstruction filter
for undersampled light fields", 2003.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.refocus import batches
from lfref.refocus.footprint import box


class Footprint(NamedTuple):
    """What a view's cell covers of the picture."""

    fill: float
    """Side of a cell in view steps, >= 0; 0: views are points, and planes the plain sums."""
    disparity: Tensor
    """Of what the pixels show: a single number, or one for each pixel where the views are, [B or 1, 1, H, W]."""
    size: tuple[int, int]
    """Height and width of a view in pixels."""

    def varies(self, slopes: Tensor) -> bool:
        """Whether some planes' blur differs from pixel to pixel, at slopes as of `widths`."""
        return self.disparity.ndim > 0 or slopes.ndim > 1

    def widths(self, slopes: Tensor) -> Tensor:
        """Widths of the boxes in pixels.

        Args:
            slopes: Of the planes, [N], or of all their pixels, [N, H, W]; float64.

        Returns:
            With their sign, [N], or [B or 1, N, H, W] if they vary.

        Raises:
            InputError: A box that is wider than the picture.
        """
        planes = slopes.reshape(1, len(slopes), *slopes.shape[1:] or (1, 1)) if self.varies(slopes) else slopes
        disparity = self.disparity
        widths = self.fill * (planes.to(disparity) - disparity if disparity.ndim else planes - float(disparity))
        if (widest := float(torch.stack(widths.detach().aminmax()).abs().max())) > max(self.size):
            raise InputError(
                f"fill * |slope - disparity| must be at most the picture's {max(self.size)} px",
                got=f"{widest:g} px",
                remedy="disparity is in pixels per view step, as slopes are",
            )
        return widths.expand(-1, -1, *self.size) if widths.ndim > 1 else widths

    def responses(self, slopes: Tensor, frequencies: Tensor) -> Tensor:
        """What the cells do to frequencies along one axis; all pass where the blur varies, which comes after.

        Args:
            slopes: Of the planes, [N], float64.
            frequencies: In cycles per pixel, [K].

        Returns:
            Real factors, [N, 1, K].
        """
        widths = torch.zeros_like(slopes) if self.varies(slopes) else self.widths(slopes)
        return box.response(widths, frequencies)[:, None]


def checked(fill: float, disparity: float | Tensor, views: Tensor) -> Footprint:
    """The footprint of the views' cells, once its numbers are known to be usable.

    Args:
        fill: Side of a cell in view steps, finite and >= 0.
        disparity: Finite, in pixels per view step: a number, or a map [H, W], or one for each light field, [..., H, W].
        views: Light fields, [..., V, U, C, H, W].

    Raises:
        InputError: Numbers that are not finite, a negative `fill`, or a map of another shape.
    """
    size = (views.shape[-2], views.shape[-1])
    if not (isinstance(fill, int | float) and math.isfinite(fill) and fill >= 0):
        raise InputError("fill must be finite and >= 0, in view steps", got=repr(fill), remedy="1 fills the aperture")
    return Footprint(float(fill), _checked_disparity(disparity, views, size), size)


def _checked_disparity(disparity: float | Tensor, views: Tensor, size: tuple[int, int]) -> Tensor:
    values = torch.as_tensor(disparity, dtype=torch.float64)
    if tuple(values.shape) not in ((), size, (*views.shape[:-5], *size)):
        raise InputError(
            f"disparity must be a number or a map {list(size)}, or one map for each light field",
            got=f"shape {list(values.shape)}",
            remedy="resize the map to the views",
        )
    if not bool(values.detach().isfinite().all()):
        raise InputError("disparity must be finite", remedy="fill its gaps, torch.nan_to_num(disparity)")
    if values.ndim == 0:
        return values.detach().cpu()
    return values.to(views.device, batches.working_dtype(views.dtype)).reshape(-1, 1, *size)
