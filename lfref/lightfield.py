"""The light field: an immutable record of views on an angular grid.

Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from lfref import encoding
from lfref.encoding import Encoding
from lfref.errors import InputError


def check_axes(views: Tensor) -> None:
    """Refuse views without the axes [..., V, U, C, H, W], or with an empty one."""
    if views.ndim < 5 or 0 in views.shape:
        raise InputError("views must be [..., V, U, C, H, W] with no axis empty", got=f"shape {list(views.shape)}")


def check_views(views: Tensor) -> None:
    """Refuse views that are not floating point, lack the axes [..., V, U, C, H, W], or have an empty one."""
    check_axes(views)
    if not views.is_floating_point():
        raise InputError("views must be floating point in [0, 1]", got=views.dtype, remedy="scale integers to [0, 1]")


@dataclass(frozen=True, eq=False)
class LightField:
    """Views of one scene from a grid of camera positions.

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
    """Trust in each sample, in [0, 1], [V, U, 1, H, W]; None means 1 everywhere."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    """Source of the field, and how it was read."""
    is_linear: bool = True
    """Whether the views hold linear light; False: they hold encoded samples, whose means are not light."""
    positions: Tensor | None = None
    """Camera positions (v, u) from the angular centre in view steps, float64, [V, U, 2]; None: an even grid."""

    def __post_init__(self) -> None:
        check_views(self.views)
        if self.views.ndim != 5:
            raise InputError("one light field is [V, U, C, H, W]", got=f"shape {list(self.views.shape)}")
        shapes = {"weight": (*self.grid, 1, *self.size), "positions": (*self.grid, 2)}
        for name, shape in shapes.items():
            given = getattr(self, name)
            if given is not None and given.shape != shape:
                raise InputError(f"{name} must be {list(shape)}", got=f"shape {list(given.shape)}")

    @property
    def grid(self) -> tuple[int, int]:
        """Number of view rows and columns (V, U)."""
        return self.views.shape[0], self.views.shape[1]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width (H, W) of a view in pixels."""
        return self.views.shape[3], self.views.shape[4]

    @property
    def picture_encoding(self) -> Encoding:
        """Encoding for pictures of the views: sRGB, or none where the views are encoded already."""
        return encoding.SRGB if self.is_linear else encoding.NONE

    def to(self, device: torch.device, non_blocking: bool = False) -> "LightField":
        """The same light field with views and weight on a device; `non_blocking` as for tensors."""
        weight = None if self.weight is None else self.weight.to(device, non_blocking=non_blocking)
        return replace(self, views=self.views.to(device, non_blocking=non_blocking), weight=weight)

    def crop(self, top: int, left: int, height: int, width: int) -> "LightField":
        """The same rectangle of every view, which begins at row `top` and column `left`."""
        if min(top, left) < 0 or min(height, width) < 1 or top + height > self.size[0] or left + width > self.size[1]:
            got = f"{height}x{width} at ({top}, {left})"
            raise InputError(f"a crop must lie inside the {self.size[0]}x{self.size[1]} views", got=got)
        window = (..., slice(top, top + height), slice(left, left + width))
        weight = None if self.weight is None else self.weight[window]
        return replace(self, views=self.views[window], weight=weight)
