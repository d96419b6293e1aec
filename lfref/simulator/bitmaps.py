"""Surfaces painted once, and what is seen of them from any point of the aperture.

A layer is a premultiplied bitmap on its surface, read where rays meet the surface: exact in geometry, cubic between
samples. Letters: `X Y`, `p q` and `x y` as in `surfaces`; `M` aperture points; `h w` rows and columns of a bitmap.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.simulator import canvases, lookups
from lfref.simulator.blurs import Bitmap, Positions
from lfref.simulator.canvases import OVERSAMPLING, Box, Canvas
from lfref.simulator.materials import Glass, Glossy, Mirror
from lfref.simulator.mattes import Full
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Geometry, Plane

SLACK = 3.0
"""Pixels that a canvas goes beyond what rays can reach, for a cubic's outer samples and for lateral effects."""


@dataclass(frozen=True, eq=False)
class Layer:
    """One painted surface, on a device."""

    surface: Surface
    bitmap: Bitmap
    """Premultiplied colours and opacity, [4, h, w]."""
    mirrored: Bitmap | None
    """What a mirror or glass shows, [3, h, w]."""
    light: Light

    @property
    def hides(self) -> bool:
        """Nothing behind it is ever seen."""
        return isinstance(self.surface.matte, Full) and total_opacity(self.surface) == 1

    @property
    def is_view_dependent(self) -> bool:
        """The same point looks different from different aperture points."""
        return self.surface.material.is_view_dependent

    def disparities(self, size: tuple[int, int]) -> tuple[float, float]:
        """Least and greatest disparity over a picture of that height and width."""
        return self.surface.geometry.disparity_range(size)

    def seen(self, p: Tensor, q: Tensor, x: Tensor, y: Tensor, blur: float | Tensor = 0.0) -> Tensor:
        """What is seen of the surface from aperture points.

        Args:
            p: Columns of the aperture points, in view steps from the centre, [M].
            q: Rows of the aperture points, [M].
            x: Columns of pixels from the picture's centre, of a shape that goes with [M, H, W].
            y: Rows of pixels from the picture's centre, of a shape that goes with [M, H, W].
            blur: Width in pixels of a further box-like low-pass, a number or [M].

        Returns:
            Premultiplied red, green, blue and opacity, float32, [M, 4, H, W].
        """
        p, q, x, y = (value.to(self.bitmap.samples.device, torch.float64) for value in (p, q, x, y))
        x, y = (value[(None,) * (3 - value.dim())] for value in (x, y))
        widths = torch.as_tensor(blur, dtype=torch.float64).reshape(-1).tolist()
        if len(set(widths)) == 1:
            return self._seen_at_one_blur(p, q, x, y, widths[0])
        parts = [
            self._seen_at_one_blur(p[m : m + 1], q[m : m + 1], _part(x, m), _part(y, m), width)
            for m, width in enumerate(widths)
        ]
        return torch.cat(parts)

    def _seen_at_one_blur(self, p: Tensor, q: Tensor, x: Tensor, y: Tensor, blur: float) -> Tensor:
        p, q = p[:, None, None], q[:, None, None]
        positions = met(self.surface.geometry, x, y, p, q)
        rgba = lookups.legal(self.bitmap.at(positions, blur))
        material = self.surface.material
        if isinstance(material, Glossy):
            rgba[:, :3] += rgba[:, 3:] * self._highlight(material, positions, p, q, blur)
        if self.mirrored is not None and isinstance(material, Mirror | Glass):
            behind = met(Plane(material.disparity), x, y, p, q)
            covered = rgba[:, 3:] / total_opacity(self.surface)
            rgba[:, :3] += material.share * covered * self.mirrored.at(behind, blur).clamp(min=0)
        return rgba

    def _highlight(self, material: Glossy, positions: Positions, p: Tensor, q: Tensor, blur: float) -> Tensor:
        """The light of the moving lobe, [M, 3, H, W]."""
        variance = material.width**2 + blur**2 / 12
        off_x = positions[0] - material.centre[0] - material.drift * p
        off_y = positions[1] - material.centre[1] - material.drift * q
        lobe = torch.exp(-(off_x**2 + off_y**2) / (2 * variance)).float()
        colour = torch.tensor(self.light.colour, device=lobe.device)[:, None, None]
        return self.light.gain * material.strength * material.width**2 / variance * lobe[:, None] * colour


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


def _part(value: Tensor, m: int) -> Tensor:
    return value[m : m + 1] if len(value) > 1 else value


def paint(scene: Scene, device: str | torch.device = "cpu", reach: float = 0.0) -> list[Layer]:
    """Paint all surfaces of a scene.

    Args:
        scene: The scene.
        device: Where the layers go; they are painted on the CPU, so that they are the same everywhere.
        reach: Greatest |slope|, in pixels per view step, that the layers will be refocused at.

    Returns:
        Layers from far to near (by their mean disparity), large enough for every aperture point.

    Raises:
        FileError: A picture cannot be read.
    """
    layers = [_painted(scene, index, reach, torch.device(device)) for index in range(len(scene.surfaces))]
    return sorted(layers, key=lambda layer: sum(layer.disparities(scene.camera.size)))


def _painted(scene: Scene, index: int, reach: float, device: torch.device) -> Layer:
    surface, key = scene.surfaces[index], (scene.seed, index)
    canvas = _canvas(scene.camera, surface.geometry, surface, reach)
    samples = _smeared(_rgba(surface, scene.light, canvas, key), surface.motion)
    mirrored, material = None, surface.material
    if isinstance(material, Mirror | Glass) and material.share * total_opacity(surface) > 0:
        behind = _canvas(scene.camera, Plane(material.disparity), None, reach)
        colours = material.texture.painted(behind, (*key, 1)) * _illumination(surface, scene.light)
        mirrored = Bitmap(behind, colours.to(device))
    return Layer(surface, Bitmap(canvas, samples.to(device)), mirrored, scene.light)


def _canvas(camera: Camera, geometry: Geometry, surface: Surface | None, reach: float) -> Canvas:
    """What rays can reach of a surface, or of all of a mirrored picture."""
    # The period must not depend on the reach: it decides what random textures look like.
    left, top, right, bottom = _box(camera, geometry, surface, 0.0)
    period = canvases.fast_length(bottom - top + 1), canvases.fast_length(right - left + 1)
    return canvases.covering(_box(camera, geometry, surface, reach), period)


def _box(camera: Camera, geometry: Geometry, surface: Surface | None, reach: float) -> Box:
    half_width, half_height = ((length - 1) / 2 for length in reversed(camera.size))
    half_p, half_q = camera.half_aperture
    half_size = (half_width + reach * half_p, half_height + reach * half_q)
    farthest = greatest_disparity(geometry, half_size, camera.half_aperture)
    ends = half_size[0] + farthest * half_p + SLACK, half_size[1] + farthest * half_q + SLACK
    motion = surface.motion if surface else (0.0, 0.0)
    box = (-ends[0], -ends[1], ends[0], ends[1])
    if surface and (limits := surface.matte.box()):
        box = canvases.intersection(box, limits)
    # A cubic smears a pixel farther than the motion goes.
    more = [abs(step) / 2 + 1 if step else 0.0 for step in motion]
    return box[0] - more[0], box[1] - more[1], box[2] + more[0], box[3] + more[1]


def greatest_disparity(geometry: Geometry, half_size: tuple[float, float], half_aperture: tuple[float, float]) -> float:
    """Bound of |disparity| that any ray of a picture meets.

    Args:
        geometry: The surface.
        half_size: Half the width and height of the picture in pixels.
        half_aperture: Half the width and height of the aperture in view steps.
    """
    size = (2 * math.ceil(half_size[1]) + 1, 2 * math.ceil(half_size[0]) + 1)
    farthest = max(map(abs, geometry.disparity_range(size)))
    change = sum(slope * half for slope, half in zip(geometry.steepness(), half_aperture, strict=True))
    return farthest / (1 - change)


def _rgba(surface: Surface, light: Light, canvas: Canvas, key: tuple[int, ...]) -> Tensor:
    """Premultiplied colours and opacity, float32, [4, h, w]."""
    coverage = surface.matte.opacity(canvas.x.float(), canvas.y.float())
    own = surface.opacity * (1 - surface.material.reflectance)
    samples = torch.empty(4, canvas.height, canvas.width)
    colours = surface.texture.painted(canvas, key) * _illumination(surface, light) * own
    torch.mul(colours, coverage, out=samples[:3])
    torch.mul(coverage, total_opacity(surface), out=samples[3])
    return samples


def _illumination(surface: Surface, light: Light) -> Tensor:
    """Light that colours are multiplied by, [3, 1, 1]."""
    own_gain = surface.material.own_gain
    colour = torch.tensor(light.colour) * light.gain if own_gain is None else torch.full((3,), float(own_gain))
    return colour[:, None, None]


def _smeared(samples: Tensor, motion: tuple[float, float]) -> Tensor:
    """The mean of a bitmap over its way during the exposure."""
    if motion == (0, 0):
        return samples
    n_places = math.ceil(OVERSAMPLING * math.hypot(*motion)) + 1
    way = OVERSAMPLING * ((torch.arange(n_places, dtype=torch.float64) + 0.5) / n_places - 0.5)
    height, width = samples.shape[-2:]
    i = torch.arange(width, dtype=torch.float64) - way[:, None, None] * motion[0]
    j = torch.arange(height, dtype=torch.float64)[:, None] - way[:, None, None] * motion[1]
    return lookups.on_grid(samples, i, j).mean(0)
