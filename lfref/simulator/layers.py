"""How far rays go: what a camera can reach of a surface, and what stands before what there.

Two surfaces that keep their order over all of the central view keep it along every ray: where a ray meets the farther
one, it is behind the nearer one already. Letters: `X Y` as in `surfaces`.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.simulator import lookups
from lfref.simulator.blurs import Bitmap, Positions
from lfref.simulator.mattes import Full
from lfref.simulator.scene import Camera, Surface
from lfref.simulator.surfaces import Geometry, Plane

# PART layers
# A painted surface, and what is seen of it from any point of the aperture.
#
# A layer is a premultiplied bitmap on its surface, read where rays meet the surface: exact in geometry, cubic between
# samples. Letters: `X Y`, `p q` and `x y` as in `surfaces`; `M` aperture points; `h w` rows and columns of a bitmap.


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
        p, q, x, y = layer_rays(p, q, x, y, self.device)
        positions = met(self.surface.geometry, x, y, p, q)
        rgba = lookups.legal(self.bitmap.at(positions))
        if self.highlight:
            rgba[:, :3] += rgba[:, 3:] * self.highlight.on(positions, p, q).to(rgba)
        if self.reflection:
            behind = met(Plane(self.reflection.disparity), x, y, p, q)
            mirrored = self.reflection.picture.at(behind)[:, :3].clamp(min=0)
            rgba[:, :3] += self.reflection.share * rgba[:, 3:] * mirrored
        return rgba


def layer_rays(
    p: Tensor, q: Tensor, x: Tensor, y: Tensor, device: torch.device
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
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


SLACK = 3.0
"""Pixels beyond what rays can reach, for the outer samples of look-ups and for lateral effects."""

Ends = tuple[float, float]
"""Greatest |X| and |Y| in pixels."""


def span(camera: Camera, geometry: Geometry, reach: float) -> tuple[float, float]:
    """Least and greatest disparity that rays may meet of a surface; arguments as for `ends`."""
    return geometry.met_range(_half_size(camera, reach), camera.half_aperture)


def ends(camera: Camera, geometry: Geometry, reach: float) -> Ends:
    """How far from the centre rays meet a surface.

    Args:
        camera: Where they start.
        geometry: The surface.
        reach: Greatest |slope| of the pictures asked for, in pixels per view step.
    """
    half_width, half_height = _half_size(camera, reach)
    half_p, half_q = camera.half_aperture
    farthest = max(map(abs, span(camera, geometry, reach)))
    return half_width + farthest * half_p + SLACK, half_height + farthest * half_q + SLACK


def _half_size(camera: Camera, reach: float) -> Ends:
    """Half the width and height of all that pictures refocused look at."""
    half_p, half_q = camera.half_aperture
    return (camera.size[1] - 1) / 2 + reach * half_p, (camera.size[0] - 1) / 2 + reach * half_q


def lead(near: Geometry, far: Geometry, within: Ends) -> tuple[float, float]:
    """Least and greatest disparity that one surface has more than another.

    Args:
        near: The one.
        far: The other.
        within: Where they are compared.
    """
    one, other = near.form, far.form
    middle = one.disparity - other.disparity
    spread = abs(one.a - other.a) * within[0] + abs(one.b - other.b) * within[1]
    lowest = min(one.bulge, 0) - max(other.bulge, 0)
    highest = max(one.bulge, 0) - min(other.bulge, 0)
    return middle - spread + lowest, middle + spread + highest


def crossing(surfaces: Sequence[Geometry], camera: Camera, reach: float) -> list[tuple[int, int]]:
    """Pairs of surfaces of which each may be before the other.

    Args:
        surfaces: Some surfaces.
        camera: What looks at them.
        reach: Greatest |slope| of the pictures asked for.

    Returns:
        Their places, the smaller first.
    """
    far = [ends(camera, surface, reach) for surface in surfaces]
    leads = {
        (k, m): lead(surfaces[m], surfaces[k], _both(far[k], far[m]))
        for k, m in itertools.combinations(range(len(surfaces)), 2)
    }
    return [pair for pair, (least, greatest) in leads.items() if least < 0 < greatest]


def is_before(near: Geometry, far: Geometry, camera: Camera, reach: float) -> bool:
    """Whether one surface is nowhere behind another; arguments as above."""
    within = _both(ends(camera, near, reach), ends(camera, far, reach))
    return lead(near, far, within)[0] >= 0


def _both(one: Ends, other: Ends) -> Ends:
    return max(one[0], other[0]), max(one[1], other[1])
