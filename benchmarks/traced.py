"""Scenes that Mitsuba traces and whose disparity is known: weak textures in light and shadow, gloss, foliage.

They stand for the photographs and synthetic benchmarks that the simulator's layers do not resemble: shading moves
otherwise than the surface, shadows fall on textured walls, and nothing is flat. The cameras are those of
`mitsuba_scenes`: a point at distance Z has disparity `FOCAL / Z - SHIFT`.
"""

import importlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.encoding import SRGB
from lfref.lightfield import LightField

GRID, SIZE = (7, 7), (192, 256)
FOCAL, SHIFT = 300.0, 6.0
"""Focal length in pixels; pixels per view step by which views move back, so that Z = 50 has disparity 0."""
SAMPLES = 16
"""Of each pixel and lamp. Lamps are points and rendered one by one: without choices by chance there is no noise, and
samples only smooth edges and textures."""
LAMPS = ("lamp", "fill")

mi: Any = importlib.import_module("mitsuba")
mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)


def noise(seed: int, size: int, decay: float, low: float, high: float, tint: tuple[float, float, float]) -> Any:
    """A texture whose amplitude falls with frequency to a power."""
    random = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)
    falling = np.maximum(np.hypot(fy, fx), 1 / size) ** -decay
    grey = np.fft.irfft2(np.fft.rfft2(random.normal(size=(size, size))) * falling, s=(size, size))
    grey = low + (high - low) * np.clip(0.5 + (grey - grey.mean()) / (5 * grey.std()), 0, 1)
    return bitmap(grey[..., None] * np.array(tint))


def bitmap(colours: NDArray[np.float64]) -> dict[str, Any]:
    """Colours [h, w, 3] as a texture."""
    return {"type": "bitmap", "bitmap": mi.Bitmap(colours.astype(np.float32)), "raw": True}


def matte(texture: Any) -> dict[str, Any]:
    """Seen from both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture}}


def plastic(texture: Any, roughness: float) -> dict[str, Any]:
    """A glossy coat on a matte ground."""
    return {"type": "roughplastic", "diffuse_reflectance": texture, "alpha": roughness}


def placed(kind: str, bsdf: dict[str, Any], *steps: Any) -> dict[str, Any]:
    """A shape after these steps, the first one first."""
    transform = mi.ScalarTransform4f()
    for step in steps:
        transform = step @ transform
    return {"type": kind, "to_world": transform, "bsdf": bsdf}


def moved(x: float, y: float, z: float) -> Any:
    """To a place: x to the right, y down, z away from the cameras."""
    return mi.ScalarTransform4f().translate([x, y, z])


def scaled(x: float, y: float, z: float) -> Any:
    """By a factor along each axis."""
    return mi.ScalarTransform4f().scale([x, y, z])


def turned(axis: tuple[float, float, float], degrees: float) -> Any:
    """Around an axis through the origin."""
    return mi.ScalarTransform4f().rotate(list(axis), degrees)


def lamps(x: float, y: float, z: float, power: float) -> dict[str, Any]:
    """A bright one, and one beside the cameras that fills the shadows."""
    places = {"lamp": ((x, y, z), power), "fill": ((5.0, -5.0, 0.0), 0.12 * power)}
    return {
        name: {"type": "point", "position": list(place), "intensity": {"type": "rgb", "value": [strength] * 3}}
        for name, (place, strength) in places.items()
    }


def statue() -> dict[str, Any]:
    """Smooth pale bodies with faint veins before a faintly textured wall, on a floor; one lamp from the left."""
    marble = plastic(noise(1, 512, 1.4, 0.3, 0.7, (1.0, 0.98, 0.93)), 0.25)
    parts = {
        "wall": placed(
            "rectangle", matte(noise(2, 512, 1.2, 0.12, 0.3, (0.9, 0.95, 0.8))), scaled(40, 40, 1), moved(0, 0, 62)
        ),
        "floor": placed(
            "rectangle",
            matte(noise(3, 512, 1.2, 0.1, 0.3, (0.95, 0.9, 0.8))),
            scaled(40, 40, 1),
            turned((1, 0, 0), 90),
            moved(0, 15, 50),
        ),
        "foot": placed("cylinder", marble, scaled(4, 4, 8), turned((1, 0, 0), 90), moved(0, 15, 50)),
        "chest": placed("sphere", marble, scaled(8, 6, 5), moved(0, 3, 50)),
        "head": placed("sphere", marble, scaled(4, 5, 4), moved(1, -6, 48)),
    }
    curls = {
        f"curl_{n}": placed(
            "sphere", marble, moved(1 + 3.6 * math.cos(n), -8 + 2.2 * math.sin(2.1 * n), 46.5 + 0.9 * math.sin(n))
        )
        for n in range(14)
    }
    return parts | curls | lamps(-25, -25, 15, 8000)


def table() -> dict[str, Any]:
    """Boxes, balls and a can with printed textures on a table; gloss and hard shadows."""
    paper = matte(noise(11, 256, 0.8, 0.1, 0.8, (0.9, 0.5, 0.3)))
    cloth = matte(noise(12, 512, 0.9, 0.15, 0.5, (0.4, 0.5, 0.8)))
    glaze = plastic(noise(13, 256, 1.4, 0.2, 0.5, (0.3, 0.8, 0.5)), 0.1)
    return {
        "wall": placed(
            "rectangle", matte(noise(14, 512, 1.3, 0.2, 0.5, (0.8, 0.75, 0.7))), scaled(45, 45, 1), moved(0, 0, 66)
        ),
        "top": placed("rectangle", cloth, scaled(40, 40, 1), turned((1, 0, 0), 90), moved(0, 12, 52)),
        "box": placed("cube", paper, scaled(4, 5, 4), turned((0, 1, 0), 35), moved(-10, 4, 54)),
        "can": placed("cylinder", glaze, scaled(3, 3, 9), turned((1, 0, 0), 90), moved(11, 12, 50)),
        "ball": placed("sphere", glaze, scaled(4, 4, 4), moved(1, 8, 45)),
        "book": placed("cube", paper, scaled(6, 0.8, 4), turned((0, 1, 0), -20), moved(3, 11.2, 43)),
    } | lamps(20, -28, 20, 9000)


def foliage() -> dict[str, Any]:
    """Leaves at many depths before a wall in their shadow."""
    random = np.random.default_rng(5)
    leaf = matte(noise(21, 128, 1.0, 0.1, 0.7, (0.4, 0.8, 0.3)))
    parts: dict[str, Any] = {
        "wall": placed(
            "rectangle", matte(noise(22, 512, 1.0, 0.2, 0.6, (0.8, 0.6, 0.5))), scaled(45, 45, 1), moved(0, 0, 64)
        )
    }
    for n in range(70):
        x, y, z = random.uniform((-19, -14, 43), (19, 14, 60))
        axis = tuple(random.normal(size=3).tolist())
        steps = (
            scaled(2.6, 1.1, 1),
            turned((0, 0, 1), float(random.uniform(0, 180))),
            turned(axis, float(random.uniform(-50, 50))),
        )
        parts[f"leaf_{n}"] = placed("disk", leaf, *steps, moved(float(x), float(y), float(z)))
    return parts | lamps(-15, -30, 10, 9000)


SCENES: dict[str, Callable[[], dict[str, Any]]] = {each.__name__: each for each in (statue, table, foliage)}


def views(name: str, grid: tuple[int, int] = GRID, size: tuple[int, int] = SIZE, samples: int = SAMPLES) -> LightField:
    """The light field of a scene, of 8-bit samples in linear light of sRGB."""
    scenes = [_loaded(name, lamp) for lamp in LAMPS]
    middle = [(n - 1) / 2 for n in grid]
    pictures = [
        [sum(_picture(scene, u - middle[1], v - middle[0], size, samples) for scene in scenes) for u in range(grid[1])]
        for v in range(grid[0])
    ]
    light = torch.stack([torch.stack(row) for row in pictures]).clamp(0, 1)
    return LightField(SRGB.decode((255 * SRGB.encode(light)).round() / 255), name)


def disparity(name: str, size: tuple[int, int] = SIZE) -> Tensor:
    """Of each pixel of the central view, in pixels per view step, [H, W]."""
    scene, (height, width) = _loaded(name, LAMPS[0]), size
    found = np.empty(size)
    for y in range(height):
        for x in range(width):
            towards = mi.ScalarVector3f((x + 0.5 - width / 2) / FOCAL, (y + 0.5 - height / 2) / FOCAL, 1.0)
            found[y, x] = scene.ray_intersect(mi.Ray3f(mi.ScalarPoint3f(0, 0, 0), towards)).t  # along z, by its length
    return torch.from_numpy(FOCAL / found - SHIFT).float()


def _loaded(name: str, lamp: str) -> Any:
    """A scene with one of its lamps."""
    parts = {part: value for part, value in SCENES[name]().items() if part == lamp or part not in LAMPS}
    return mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 2}, **parts})


def _picture(scene: Any, p: float, q: float, size: tuple[int, int], samples: int) -> Tensor:
    """The view of a camera at (p, q) view steps, [3, H, W]."""
    height, width = size
    sensor = {
        "type": "perspective",
        "fov": math.degrees(2 * math.atan(width / 2 / FOCAL)),
        "near_clip": 0.1,
        "principal_point_offset_x": SHIFT * p / width,
        "principal_point_offset_y": SHIFT * q / height,
        "to_world": mi.ScalarTransform4f().look_at([-p, -q, 0], [-p, -q, 1], [0, -1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "multijitter", "sample_count": samples},
    }
    return torch.from_numpy(np.array(mi.render(scene, sensor=mi.load_dict(sensor), spp=samples))).movedim(-1, 0)
