"""Scenes of the simulator in Mitsuba 3, a path tracer that shares no code with ours and checks views and truth.

In our simulator, the view from aperture point (p, q) shows a point (X, Y) of the central view at x = X + d p,
y = Y + d q. In Mitsuba, a pinhole at the origin that looks along Z, of focal length f in pixels, sees (A, B, Z) at
X = f A / Z. The view from (p, q) is that of a pinhole at (-p, -q, 0), in view steps; the signs are negative, since a
main lens inverts its aperture. This pinhole sees the point at f (A + p) / Z = X + p f / Z. Its sensor moves too, so
that the picture moves back by c p: d = f / Z - c. Hence surfaces stand at

    Z = f / (d + c),   (A, B) = (X, Y) Z / f.

Disparity 0 is at f / c, and disparity -c is at infinity; a plane in space has a d that is affine in (X, Y). A lens
focused at slope s collects at pixel x the rays through all (p, q) that pass x in the plane of disparity s. That is a
thin lens focused at f / (s + c), with its radius in view steps. A square aperture is a set of pinholes all over it,
whose pictures move back by (c + s) p.

Our textures are what pixels record: means over the area of a pixel. Mitsuba gets the radiance that has these means. Its
outlines are ideal, and its pixels average over their area (box filter). Surfaces emit their light, since ours do not
cast shadows or light on each other. The module needs the extra `mitsuba`.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import mitsuba as mi
import numpy as np
import torch
from torch import Tensor

import lfref
from lfref.functional.psnr import psnr
from lfref.simulator import materials, painting
from lfref.simulator.bitmaps import OVERSAMPLING, Canvas
from lfref.simulator.materials import Emissive, Mirror
from lfref.simulator.mattes import Disc, Full, Outline, Polygon
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Noise, Stripes, Texture

SIZE = (64, 96)
"""Height and width of the pictures."""
SLOPES = (-1.0, 0.3, 0.9)
"""Slopes of the truths that are compared, in pixels per view step: behind, among and in front of the surfaces."""
VIEWS = ((3, 3), (0, 0), (6, 1))
"""Row and column of the views that are compared: the middle, a corner, an edge."""
SHINES = Emissive()

# Scenes that both renderers can show. Together they cover all cases of the geometry; their colours are bright
# enough to be sharpened without falling below 0.


def cards(aperture: str = "disc") -> Scene:
    """A background, a half-opaque disc and a card that hides both."""
    wall = Surface(Plane(-1.0), Noise((0.5, 0.4, 0.4), (0.25, 0.25, 0.2)), material=SHINES)
    pane = Surface(Plane(0.3), Stripes(9.0, angle=20), Disc(14.0, (-20.0, 4.0)), SHINES, opacity=0.6)
    checker = Checker(12.0, (0.3, 0.2, 0.25), (0.9, 0.8, 0.4), angle=30)
    return _scene("cards", aperture, wall, pane, Surface(Plane(0.9), checker, _card(2.5, -14, 30, 17.25), SHINES))


def relief(aperture: str = "disc") -> Scene:
    """A slanted background behind a dome: disparity changes all over the picture."""
    wall = Surface(Plane(-1.0, (0.008, -0.006)), Noise((0.4, 0.5, 0.6), (0.2, 0.3, 0.3)), material=SHINES)
    ball = Surface(Dome(0.2, 0.6, 30.0), Noise((0.7, 0.6, 0.4), (0.2, 0.2, 0.2)), Disc(22.0, (6.0, -2.0)), SHINES)
    return _scene("relief", aperture, wall, ball)


def mirror(aperture: str = "disc") -> Scene:
    """A mirror in front of a background; the mirrored picture stands behind the cameras."""
    wall = Surface(Plane(-1.5), Noise((0.4, 0.4, 0.5), (0.2, 0.2, 0.3)), material=SHINES)
    shown = Mirror(0.8, Checker(14.0, (0.3, 0.3, 0.3), angle=15), disparity=-2.0)
    return _scene("mirror", aperture, wall, Surface(Plane(0.5), Flat((0.8, 0.3, 0.2)), _card(-30, -20, 25, 20), shown))


SCENES = (cards, relief, mirror)


def apart_from_edges(image: Tensor, truth: Tensor) -> float:
    """PSNR of pictures [3, H, W] without the worst twentieth of their pixels: those on edges."""
    errors = (image - truth).double().square().mean(0).flatten().sort().values
    return float(-10 * errors[: len(errors) * 19 // 20].mean().log10())


def _scene(name: str, aperture: str, *surfaces: Surface) -> Scene:
    return Scene(Camera((7, 7), SIZE, aperture), surfaces, name=name)


def _card(left: float, top: float, right: float, bottom: float) -> Polygon:
    return Polygon(((left, top), (right, top), (right, bottom), (left, bottom)))


FOCAL = 100.0
"""f, in pixels. Pictures do not depend on it: it scales distances."""
HORIZON = 4.0
"""c, in pixels per view step: disparity -c is at infinity, so that all surfaces need larger disparities."""
FINER = 4
"""Texels of Mitsuba's bitmaps per sample of a canvas, along each axis."""
MARGIN = 32
"""Samples painted around a canvas, beyond the ringing of the sharpening filter."""

mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)


class MitsubaScene:
    """A scene for Mitsuba to render.

    Args:
        scene: Emissive surfaces and mirrors. Outlines are full, discs, or have four corners, clockwise in the picture.
    """

    def __init__(self, scene: Scene) -> None:
        self.camera = scene.camera
        parts: dict[str, Any] = {}
        for layer in painting.paint(scene):
            index = layer.index
            parts[f"surface_{index}"] = _surface(layer.surface, layer.bitmap.canvas, (scene.seed, index))
            if layer.reflection:
                canvas = layer.reflection.picture.canvas
                parts[f"mirrored_{index}"] = _mirrored(layer.surface, canvas, (scene.seed, index, 1))
        self.scene = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 4}, **parts})

    def view(self, p: float, q: float, slope: float = 0.0, samples: int = 64, seed: int = 0) -> Tensor:
        """Picture of a pinhole at (p, q), shifted so that the plane of the slope stays in place, [3, H, W]."""
        height, width = self.camera.size
        x, y = ((HORIZON + slope) * offset / length for offset, length in ((p, width), (q, height)))
        pinhole = {"type": "perspective", "principal_point_offset_x": x, "principal_point_offset_y": y}
        return self._render(pinhole, (-p, -q), samples, seed)

    def through_disc(self, slope: float, samples: int = 256, seed: int = 0) -> Tensor:
        """Picture of a thin lens whose disc spans the views, [3, H, W]."""
        radius = min(self.camera.grid) / 2
        lens = {"type": "thinlens", "aperture_radius": radius, "focus_distance": float(distance(slope))}
        return self._render(lens, (0, 0), samples, seed)

    def through_square(self, slope: float, side: int = 12, samples: int = 4, seed: int = 0) -> Tensor:
        """Mean picture of pinholes, one at a random point of each of side x side parts of the square, [3, H, W]."""
        random = np.random.default_rng(seed)
        parts = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
        points = ((parts + random.uniform(size=parts.shape)) / side - 0.5) * self.camera.grid[::-1]
        pictures = [self.view(p, q, slope, samples, seed + n) for n, (p, q) in enumerate(points.tolist())]
        return torch.stack(pictures).mean(0)

    def _render(self, lens: dict[str, Any], origin: tuple[float, float], samples: int, seed: int) -> Tensor:
        """Picture of a lens that looks along Z from a place, [3, H, W]."""
        height, width = self.camera.size
        film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb"}
        sensor = {
            **lens,
            "fov": math.degrees(2 * math.atan(width / 2 / FOCAL)),
            "near_clip": 0.01,
            "to_world": mi.ScalarTransform4f().look_at([*origin, 0], [*origin, 1], [0, -1, 0]),
            "film": {**film, "component_format": "float32", "rfilter": {"type": "box"}},
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
        picture = mi.render(self.scene, sensor=mi.load_dict(sensor), spp=samples, seed=seed)
        return torch.from_numpy(np.array(picture)).movedim(-1, 0)


def distance(disparity: Any) -> Any:
    """Z of a disparity, a number or a tensor."""
    return FOCAL / (disparity + HORIZON)


def mesh_points(matte: Outline, canvas: Canvas) -> tuple[Tensor, Tensor]:
    """X and Y of a mesh that fills an outline, or all of a canvas.

    Turning from the first axis of the mesh to the second is clockwise in the picture.
    """
    shares = torch.linspace(0, 1, 97, dtype=torch.float64)
    first, second = torch.meshgrid(shares, shares, indexing="ij")
    if isinstance(matte, Disc):
        # In polar coordinates: from the centre outwards, and around.
        radius, angle = matte.radius * first, 2 * torch.pi * second
        return matte.centre[0] + radius * torch.cos(angle), matte.centre[1] + radius * torch.sin(angle)
    left, right, top, bottom = (float(edge) for edge in (*canvas.x[[0, -1]], *canvas.y[[0, -1]]))
    whole = ((left, top), (right, top), (right, bottom), (left, bottom))
    corners = matte.corners if isinstance(matte, Polygon) else whole
    weights = ((1 - first) * (1 - second), first * (1 - second), first * second, (1 - first) * second)
    x, y = (
        sum(share * corner for share, corner in zip(weights, axis, strict=True)) for axis in zip(*corners, strict=True)
    )
    return x, y


def _surface(surface: Surface, canvas: Canvas, key: tuple[int, ...]) -> Any:
    material = surface.material
    x, y = mesh_points(surface.matte, canvas)
    z = distance(surface.geometry.disparity_at(x, y).expand(x.shape))
    points = torch.stack([x * z / FOCAL, y * z / FOCAL, z], -1)
    colours = _sharpened_texture(surface.texture, canvas, key)
    bsdf: dict[str, Any] = {"type": "conductor", "specular_reflectance": materials.reflectance(material)}
    if surface.opacity < 1:
        bsdf = {"type": "mask", "opacity": surface.opacity, "bsdf": bsdf}
    gain = material.gain if isinstance(material, Emissive) else 1.0
    own = gain * surface.opacity * (1 - materials.reflectance(material))
    return _mesh(points, _texture_coordinates(x, y, canvas), bsdf, {"type": "area", "radiance": _bitmap(own * colours)})


def _mirrored(surface: Surface, canvas: Canvas, key: tuple[int, ...]) -> Any:
    """The picture that a mirror shows: it stands behind the cameras, as far from the mirror as its image is."""
    material: Any = surface.material
    x, y = mesh_points(Full(), canvas)
    image, mirror = distance(material.disparity), distance(surface.geometry.form.disparity)
    assert image > 2 * mirror, "the mirrored picture must stand behind the cameras"
    points = torch.stack([x * image / FOCAL, y * image / FOCAL, torch.full_like(x, 2 * mirror - image)], -1)
    colours = _bitmap(_sharpened_texture(material.texture, canvas, key))
    # Flipped: it faces the mirror.
    black, light = {"type": "conductor", "specular_reflectance": 0.0}, {"type": "area", "radiance": colours}
    return _mesh(points.flip(0), _texture_coordinates(x, y, canvas).flip(0), black, light)


def _sharpened_texture(texture: Texture, canvas: Canvas, key: tuple[int, ...]) -> Tensor:
    """Colours whose means over pixels are the painted colours, [FINER h, FINER w, 3], with MARGIN around the canvas."""
    left, top, width, height = canvas.left, canvas.top, canvas.width, canvas.height
    wide = Canvas(left - MARGIN, top - MARGIN, width + 2 * MARGIN, height + 2 * MARGIN, canvas.period)
    painted = texture.paint(wide, key).double()
    for axis in (-2, -1):
        # Together with its mirror image, the texture is periodic without a jump. The mean over a pixel multiplies a
        # spectrum by sinc(f): that is undone up to half a cycle per pixel, where all textures end.
        endless = torch.cat([painted, painted.flip(axis)], axis).movedim(axis, -1)
        length = endless.shape[-1]
        cycles = (OVERSAMPLING * torch.fft.rfftfreq(length, dtype=torch.float64)).clamp(max=0.5)
        sharp = torch.fft.irfft(torch.fft.rfft(endless) / torch.sinc(cycles), n=FINER * length) * FINER
        painted = sharp[..., : FINER * length // 2].movedim(-1, axis)
    return painted.movedim(0, -1)


def _texture_coordinates(x: Tensor, y: Tensor, canvas: Canvas) -> Tensor:
    """Coordinates, from 0 to 1, of a surface's points in the bitmap of `_sharpened_texture`, [..., 2]."""
    columns, rows = x * OVERSAMPLING - canvas.left + MARGIN, y * OVERSAMPLING - canvas.top + MARGIN
    # A texel's middle is half a texel from its edge.
    u, v = ((at + 0.5 / FINER) / (n + 2 * MARGIN) for at, n in ((columns, canvas.width), (rows, canvas.height)))
    return torch.stack([u, v], -1)


def _bitmap(values: Tensor) -> dict[str, Any]:
    assert values.min() >= 0, "colours are too dark, so that sharp ones fall below 0"
    return {"type": "bitmap", "bitmap": mi.Bitmap(values.float().numpy()), "raw": True, "wrap_mode": "clamp"}


def _mesh(points: Tensor, coordinates: Tensor, bsdf: dict[str, Any], light: dict[str, Any] | None = None) -> Any:
    """A mesh of points [.., 3] with texture coordinates [.., 2].

    Seen from the front, the turn from the first axis of the points to the second is clockwise.
    """
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    if light is not None:
        properties["emitter"] = mi.load_dict(light)
    index = torch.arange(points[..., 0].numel()).reshape(points.shape[:2])
    first, right, across, below = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = torch.cat([torch.stack([first, across, right], -1), torch.stack([first, below, across], -1)])
    mesh = mi.Mesh("", index.numel(), faces[..., 0].numel(), props=properties, has_vertex_texcoords=True)
    values = mi.traverse(mesh)
    values["vertex_positions"] = points.float().flatten().numpy()
    values["vertex_texcoords"] = coordinates.float().flatten().numpy()
    values["faces"] = faces.flatten().numpy().astype(np.uint32)
    values.update()
    return mesh


# The table of the page on the simulator

TWO_NOISES = 10 * math.log10(2)
"""Decibels by which two noisy pictures differ more from each other than each from what it should be."""


def table() -> Iterator[str]:
    """The least PSNR of views and truth of each scene, and of Mitsuba's pictures against others of its own."""
    yield "| scene | views, dB | apart from edges, dB | truth, disc, dB | truth, square, dB | Mitsuba's noise, dB |"
    yield "|---|---|---|---|---|---|"
    for make in SCENES:
        world = MitsubaScene(make())
        ours = lfref.simulate(make(), outputs=("views",), slopes=[0.0]).views
        views = [ours[view] for view in VIEWS], [world.view(u - 3, v - 3, samples=256) for v, u in VIEWS]
        values = [_least(psnr, *views), _least(apart_from_edges, *views)]
        discs, others = ([world.through_disc(slope, seed=seed) for slope in SLOPES] for seed in (0, 1))
        squares = [world.through_square(slope) for slope in SLOPES]
        for aperture, theirs in (("disc", discs), ("square", squares)):
            truth = lfref.simulate(make(aperture), outputs=("truth",), slopes=SLOPES).truth
            values.append(_least(psnr, truth, theirs))
        values.append(_least(psnr, discs, others) + TWO_NOISES)
        yield " | ".join([f"| {make.__name__}", *(f"{value:.1f}" for value in values)]) + " |"


def _least(measure: Callable[[Tensor, Tensor], Any], ours: Iterable[Tensor], theirs: Iterable[Tensor]) -> float:
    return min(float(measure(one, other)) for one, other in zip(ours, theirs, strict=True))


if __name__ == "__main__":
    print(*table(), sep="\n")
