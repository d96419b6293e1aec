"""The light field: an immutable record of views on an angular grid.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from lfref.errors import InputError


def check_axes(views: Tensor) -> None:
    """Refuse what has not the axes of a light field.

    Args:
        views: Should be [..., V, U, C, H, W], no axis empty.

    Raises:
        InputError: Another number of axes, or an empty one.
    """
    if views.ndim < 5 or 0 in views.shape:
        raise InputError("views must be [..., V, U, C, H, W] with no axis empty", got=f"shape {list(views.shape)}")


def check_views(views: Tensor) -> None:
    """Refuse what is not a light field of radiances.

    Args:
        views: Should be floating point, [..., V, U, C, H, W], no axis empty.

    Raises:
        InputError: Another number of axes, an empty axis, or another type.
    """
    check_axes(views)
    if not views.is_floating_point():
        raise InputError("views must be floating point in [0, 1]", got=views.dtype, remedy="scale integers to [0, 1]")


@dataclass(frozen=True, eq=False)
class LightField:
    """Views of one scene from a regular grid of positions.

    Example:
        >>> field = LightField(torch.rand(7, 7, 3, 32, 48), name="noise")
        >>> field.grid, field.size
        ((7, 7), (32, 48))
    """

    views: Tensor
    """Radiance in [0, 1], floating point, [V, U, C, H, W]."""
    name: str = ""
    """Short name, used for files and table rows."""
    weight: Tensor | None = None
    """How far each sample is to be trusted, in [0, 1], [V, U, 1, H, W]; None means fully everywhere."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """Where the field came from and how it was read."""
    positions: Tensor | None = None
    """(v, u) of each camera from the angular centre, in view steps, float64, [V, U, 2]; None: the even grid."""

    def __post_init__(self) -> None:
        check_views(self.views)
        if self.views.ndim != 5:
            raise InputError("one light field is [V, U, C, H, W]", got=f"shape {list(self.views.shape)}")
        n_rows, n_columns, _, height, width = self.views.shape
        expected = (n_rows, n_columns, 1, height, width)
        if self.weight is not None and self.weight.shape != expected:
            raise InputError(f"weight must be {list(expected)}", got=f"shape {list(self.weight.shape)}")

    @property
    def grid(self) -> tuple[int, int]:
        """Number of view rows and columns (V, U)."""
        return self.views.shape[0], self.views.shape[1]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width (H, W) of a view in pixels."""
        return self.views.shape[3], self.views.shape[4]

    def to(self, device: torch.device) -> "LightField":
        """The same light field on a device.

        Args:
            device: Where its tensors go.
        """
        weight = None if self.weight is None else self.weight.to(device)
        return replace(self, views=self.views.to(device), weight=weight)

    def crop(self, top: int, left: int, height: int, width: int) -> "LightField":
        """The same rectangle of every view.

        Args:
            top: First row, in pixels.
            left: First column, in pixels.
            height: Rows to keep, in pixels.
            width: Columns to keep, in pixels.

        Raises:
            InputError: The rectangle does not lie inside the views.
        """
        if min(top, left) < 0 or min(height, width) < 1 or top + height > self.size[0] or left + width > self.size[1]:
            raise InputError(
                f"a crop must lie inside the {self.size[0]}x{self.size[1]} views",
                got=f"{height}x{width} at ({top}, {left})",
            )
        window = (..., slice(top, top + height), slice(left, left + width))
        weight = None if self.weight is None else self.weight[window]
        return replace(self, views=self.views[window], weight=weight)
