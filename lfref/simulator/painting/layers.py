"""A painted surface, and what is seen of it from any point of the aperture.

A layer is a premultiplied bitmap on its surface, read where rays meet the surface: exact in geometry, cubic between
samples. Letters: `X Y`, `p q` and `x y` as in `surfaces`; `M` aperture points; `h w` rows and columns of a bitmap.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.simulator.mattes import Full
from lfref.simulator.reading import lookups
from lfref.simulator.reading.blurs import Bitmap, Positions
from lfref.simulator.scene import Surface
from lfref.simulator.surfaces import Geometry, Plane


class Highlight(NamedTuple):
    """A round lobe of light that moves over a surface with the aperture point; see `materials.Glossy`."""

    red: float
    green: float
    blue: float
    width: float
    drift: float
    x: float
    y: float

    def on(self, positions: Positions, p: Tensor, q: Tensor, way: float | Tensor = 0.0) -> Tensor:
        """Its light at points of the surface.

        Args:
            positions: The points.
            p: Columns of the aperture points, [M, 1, 1].
            q: Rows of the aperture points, [M, 1, 1].
            way: Pixels over which it is spread evenly, along both axes.

        Returns:
            float64, [M, 3, H, W].
        """
        off_x = positions[0] - self.x - self.drift * p
        off_y = positions[1] - self.y - self.drift * q
        variance = self.width**2 + way**2 / 12
        lobe = torch.exp(-(off_x**2 + off_y**2) / (2 * variance)) * self.width**2 / variance
        return lobe[:, None] * lobe.new_tensor(self[:3])[:, None, None]


class Reflection(NamedTuple):
    """Another picture that a mirror or glass shows."""

    picture: Bitmap
    """Opaque all over, [4, h, w]."""
    share: float
    """Of its light, for each unit of the surface's opacity."""
    disparity: float
    """In pixels per view step."""


@dataclass(frozen=True, eq=False)
class Layer:
    """One painted surface, on a device."""

    surface: Surface
    bitmap: Bitmap
    """Premultiplied colours and opacity, [4, h, w]."""
    place: int = 0
    """In the scene's list."""
    highlight: Highlight | None = None
    reflection: Reflection | None = None
    is_traced: bool = False
    """Its rays are followed one by one; otherwise every view is a shifted copy."""
    is_sorted: bool = False
    """Its place among other layers is found at each pixel."""

    @property
    def device(self) -> torch.device:
        """Where it lies."""
        return self.bitmap.samples.device

    @property
    def hides(self) -> bool:
        """Nothing behind it is ever seen."""
        return hides(self.surface)

    def seen(self, p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """What is seen of the surface from aperture points.

        Args:
            p: Columns of the aperture points, in view steps from the centre, [M].
            q: Rows of the aperture points, [M].
            x: Columns of pixels from the picture's centre, of a shape that goes with [M, H, W].
            y: Rows of pixels from the picture's centre, of a shape that goes with [M, H, W].

        Returns:
            Premultiplied red, green, blue and opacity, float32, [M, 4, H, W].
        """
        p, q, x, y = rays(p, q, x, y, self.device)
        positions = met(self.surface.geometry, x, y, p, q)
        rgba = lookups.legal(self.bitmap.at(positions))
        if self.highlight:
            rgba[:, :3] += rgba[:, 3:] * self.highlight.on(positions, p, q).to(rgba)
        if self.reflection:
            behind = met(Plane(self.reflection.disparity), x, y, p, q)
            mirrored = self.reflection.picture.at(behind)[:, :3].clamp(min=0)
            rgba[:, :3] += self.reflection.share * rgba[:, 3:] * mirrored
        return rgba


def rays(p: Tensor, q: Tensor, x: Tensor, y: Tensor, device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Aperture points [M, 1, 1] and pixels of three axes, float64, on a device; arguments as for `Layer.seen`."""
    p, q, x, y = (value.to(device, torch.float64) for value in (p, q, x, y))
    return p[:, None, None], q[:, None, None], x[(None,) * (3 - x.dim())], y[(None,) * (3 - y.dim())]


def met(geometry: Geometry, x: Tensor, y: Tensor, p: Tensor, q: Tensor) -> Positions:
    """Where rays meet a surface, on grids where it faces the camera.

    Args:
        geometry: The surface.
        x: Columns of pixels, of a shape that goes with [M, H, W].
        y: Rows of pixels, likewise.
        p: Columns of the aperture points, [M, 1, 1].
        q: Rows of the aperture points, [M, 1, 1].
    """
    shape = torch.broadcast_shapes(x.shape, y.shape, p.shape)
    # One pixel is enough where disparity is the same everywhere; all of them would undo the grid.
    some = slice(1) if geometry.is_parallel else slice(None)
    disparity = geometry.met_at(x[..., some, some], y[..., some, some], p, q)
    at_x, at_y = x - disparity * p, y - disparity * q
    if at_x.shape[-2] == 1 and at_y.shape[-1] == 1:
        return at_x.expand(shape[0], 1, shape[2]), at_y.expand(shape[0], shape[1], 1)
    return at_x.expand(shape), at_y.expand(shape)


def total_opacity(surface: Surface) -> float:
    """Opacity within the outline: what is not mirrored meets the surface's own opacity."""
    return 1 - (1 - surface.material.reflectance) * (1 - surface.opacity)


def hides(surface: Surface) -> bool:
    """Whether nothing behind a surface is ever seen."""
    return isinstance(surface.matte, Full) and total_opacity(surface) == 1


def only_shifts(surface: Surface) -> bool:
    """Whether a surface looks but shifted from any other aperture point."""
    return surface.geometry.is_parallel and not surface.material.is_view_dependent
