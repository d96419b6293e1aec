"""Layers: painted surfaces, their light along rays, the reach of rays, and layers that cross each other.

A layer is a bitmap on its surface, premultiplied by its opacity, and read where rays meet the surface: exact in
geometry, cubic between samples. If the order of disparity of two surfaces is the same everywhere in the central view,
it is the same along every ray, since surfaces that meet on a ray have equal disparities at one point (X, Y). So only
surfaces that cross need sorting by depth.
Letters: `X Y`, `p q`, `x y` and `D` as in `surfaces`; `M` aperture points; `h w` rows and columns of a bitmap.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from lfref.simulator import materials
from lfref.simulator.bitmaps import Bitmap
from lfref.simulator.mattes import Full
from lfref.simulator.scene import Camera, Surface
from lfref.simulator.surfaces import Geometry


class Highlight(NamedTuple):
    """A round lobe of light that moves over a surface with the aperture point; see `materials.Glossy`."""

    red: float
    green: float
    blue: float
    width: float
    drift: float
    x: float
    y: float


class Reflection(NamedTuple):
    """The picture that a mirror or glass shows."""

    picture: Bitmap  # opaque all over, [4, h, w]
    share: float  # share of its light per unit of the surface's opacity
    disparity: float  # disparity of the picture in pixels per view step


@dataclass(frozen=True, eq=False)
class Layer:
    """One painted surface."""

    surface: Surface
    bitmap: Bitmap  # premultiplied colours and opacity, [4, h, w]
    index: int = 0  # index of the surface in the scene's list
    highlight: Highlight | None = None
    reflection: Reflection | None = None
    is_traced: bool = False  # whether its rays are followed one by one; otherwise every view is a shifted copy
    is_sorted: bool = False  # whether it crosses another layer, so that layers are sorted at each pixel


def total_opacity(surface: Surface) -> float:
    """Opacity within the outline: the mirrored share hides the background; the rest has the surface's own opacity."""
    return 1 - (1 - materials.reflectance(surface.material)) * (1 - surface.opacity)


def is_backdrop(surface: Surface) -> bool:
    """Whether a surface hides everything behind it: opaque and without an edge."""
    return isinstance(surface.matte, Full) and total_opacity(surface) == 1


def only_shifts(surface: Surface) -> bool:
    """Whether views of a surface differ by a shift alone."""
    material = surface.material
    return surface.geometry.is_parallel and not (materials.is_glossy(material) or materials.reflectance(material))


Extent = tuple[float, float]
"""Greatest |X| and |Y| in pixels."""


def disparity_span(camera: Camera, geometry: Geometry, reach: float) -> tuple[float, float]:
    """Least and greatest disparity at which rays can meet a surface; arguments as for `ray_extent`."""
    return geometry.ray_disparity_range(_half_size(camera, reach), camera.half_aperture)


def ray_extent(camera: Camera, geometry: Geometry, reach: float) -> Extent:
    """Distance from the centre up to which rays meet a surface, for pictures refocused at slopes up to `reach`."""
    half_width, half_height = _half_size(camera, reach)
    half_p, half_q = camera.half_aperture
    farthest = max(map(abs, disparity_span(camera, geometry, reach)))
    # Beyond this distance, cubic look-ups read one pixel, and the lens's box filters up to two more. The period of
    # random textures follows from the sum: another number changes all scenes.
    return half_width + farthest * half_p + 3.0, half_height + farthest * half_q + 3.0


def _half_size(camera: Camera, reach: float) -> Extent:
    """Greatest |x| and |y| of the rays of refocused pictures, x + s p and y + s q."""
    half_p, half_q = camera.half_aperture
    return (camera.size[1] - 1) / 2 + reach * half_p, (camera.size[0] - 1) / 2 + reach * half_q


def disparity_lead(near: Geometry, far: Geometry, within: Extent) -> tuple[float, float]:
    """Bounds of the difference between the disparities of two surfaces, over a part of the central view."""
    one, other = near.form, far.form
    middle = one.disparity - other.disparity
    spread = abs(one.a - other.a) * within[0] + abs(one.b - other.b) * within[1]
    lowest = min(one.bulge, 0) - max(other.bulge, 0)
    highest = max(one.bulge, 0) - min(other.bulge, 0)
    return middle - spread + lowest, middle + spread + highest


def crossing_pairs(surfaces: Sequence[Geometry], camera: Camera, reach: float) -> list[tuple[int, int]]:
    """Pairs of indices, the smaller first, of surfaces that cross: each may be in front of the other somewhere."""
    pairs = []
    for k, m in itertools.combinations(range(len(surfaces)), 2):
        least, greatest = disparity_lead(surfaces[m], surfaces[k], _shared(surfaces[k], surfaces[m], camera, reach))
        if least < 0 < greatest:
            pairs.append((k, m))
    return pairs


def is_before(near: Geometry, far: Geometry, camera: Camera, reach: float) -> bool:
    """Whether the surface `near` is nowhere behind the surface `far`."""
    return disparity_lead(near, far, _shared(near, far, camera, reach))[0] >= 0


def _shared(one: Geometry, other: Geometry, camera: Camera, reach: float) -> Extent:
    """The larger extent of two surfaces along each axis."""
    width, height = zip(*(ray_extent(camera, shape, reach) for shape in (one, other)), strict=True)
    return max(width), max(height)
