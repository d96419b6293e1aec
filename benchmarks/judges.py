"""Path-traced judges: eight scenes of Mitsuba 3, by whose views and truth methods are compared.

`render` fills the cache folder picture by picture and may be stopped and started again; `checksums` compares what it
holds with `judges.json`; `score` fills the table of docs/accuracy.md. World points (X, Y, FOCAL) / (d + HORIZON) are
seen by the central view at (X, Y) pixels from its centre, X to the right and Y down, at disparity d;
tests/simulator/path_tracer.py derives the signs. Letters: `x y` pixels, `d` disparity in pixels per view step, `p q`
place on the aperture in view steps.

Rendering needs the extra `mitsuba` and an LLVM newer than 15; `DRJIT_LIBLLVM_PATH` names its library where an older one
is found first. Scoring needs no LLVM. `judges.json` has the seeds, the first slope and the step of the planes, the
greatest depth of paths, and samples per pixel.
"""

import argparse
import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pages
import torch
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from tqdm import tqdm

import lfref
from lfref.functional.psnr import MEAN_CAP_DB
from lfref.io import atomic, images
from lfref.refocus.joint_wiener import prior_of_map, refocus_jointly
from lfref.refocus.mean_of_views import mean_of_views
from lfref.report.pictures import for_display

mi.set_variant("llvm_ad_rgb")
mi.set_log_level(mi.LogLevel.Error)
CACHE = Path.home() / ".cache" / "lfref" / "judges"
RECORD = Path(__file__).with_suffix(".json")
SETTINGS: dict[str, dict[str, Any]] = json.loads(RECORD.read_text("utf-8"))
SIZE, GRID, N_PLANES = (192, 256), 7, 16
FOCAL, HORIZON = 400.0, 4.0
"""Focal length in pixels; disparity -HORIZON is at infinity."""
AT_ONCE = 144
"""Samples of a pixel that are rendered together, a square number, which the sampler can stratify."""
BORDER = 8
"""Pixels at the border that do not count."""
NOISE = 0.02
"""Deviation of noise that is added to views."""
Part = dict[str, Any] | mi.Object
Scene = dict[str, Part]

# Parts of scenes


def at(x: ArrayLike, y: ArrayLike, d: ArrayLike) -> NDArray:
    """World points [..., 3] that the central view shows at pixels (x, y) from its centre."""
    x, y, d = np.broadcast_arrays(x, y, d)
    return np.stack([x, y, np.full(x.shape, FOCAL)], -1) / (d + HORIZON)[..., None]


def sheet(points: NDArray, bsdf: Part, light: Part | None = None) -> mi.Mesh:
    """A mesh of grids of points [..., a, b, 3]; pictures [h, w, 3] as colours span each grid."""
    rows, columns = points.shape[-3:-1]
    count = points[..., 0].size
    index = np.arange(count).reshape(-1, rows, columns)
    first, right, below, across = index[:, :-1, :-1], index[:, :-1, 1:], index[:, 1:, :-1], index[:, 1:, 1:]
    faces = np.concatenate([np.stack([first, across, right], -1), np.stack([first, below, across], -1)], -1)
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf) if isinstance(bsdf, dict) else bsdf
    if light is not None:
        properties["emitter"] = mi.load_dict(light)
    mesh = mi.Mesh("sheet", count, faces.size // 3, properties, has_vertex_normals=True, has_vertex_texcoords=True)
    values = mi.traverse(mesh)
    values["faces"] = faces.ravel().astype(np.uint32)
    values["vertex_texcoords"] = np.tile(np.stack([u, v], -1).ravel(), len(index)).astype(np.float32)
    values["vertex_positions"] = points.ravel().astype(np.float32)
    values.update()
    return mesh


def card(left: float, top: float, right: float, bottom: float, d: ArrayLike, bsdf: Part, **more: Any) -> mi.Mesh:
    """A flat card by its edges in pixels; `d` is one disparity, or those of its corners, [[., .], [., .]]."""
    edges = np.linspace(*np.broadcast_to(d, (2, 2)), 33)
    y = np.linspace(top, bottom, 33)[:, None]
    return sheet(at(np.linspace(left, right, 33), y, np.linspace(*edges.T, 33, axis=1)), bsdf, **more)


def ground(height: float, near: float, far: float, bsdf: Part) -> mi.Mesh:
    """A level floor, `height` world units below the camera, between two disparities."""
    z = FOCAL / (np.array([[far], [near]]) + HORIZON)
    x = np.array([[-1.0, 1.0]]) * z[0]
    return sheet(np.stack(np.broadcast_arrays(x, height, z), -1), bsdf)


def tubes(paths: NDArray, radii: ArrayLike, bsdf: Part, sides: int = 5) -> mi.Mesh:
    """Round tubes along paths [n, k, 3] with radii [n, k] in world units."""
    along = np.gradient(paths, axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.cross(along, [0.31, 0.17, 0.93])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    turns = np.linspace(0, 2 * np.pi, sides + 1)[:, None]
    rings = np.cos(turns) * across[:, :, None] + np.sin(turns) * np.cross(along, across)[:, :, None]
    return sheet(paths[:, :, None] + np.asarray(radii)[..., None, None] * rings, bsdf)


def lathe(x: float, y: float, d: float, profile: str, bsdf: Part, scale: float = 1.0) -> mi.Mesh:
    """A turned object that stands on (x, y); the corners of its profile, radius and height in turn, are rounded."""
    points = scale * np.array(profile.split(), float).reshape(-1, 2)
    places = np.linspace(0, len(points) - 1, 16 * len(points))
    kernel = np.hanning(17)[1:-1] / np.hanning(17).sum()
    lines = [np.pad(np.interp(places, range(len(points)), line), 7, "reflect", reflect_type="odd") for line in points.T]
    radius, height = (np.convolve(line, kernel, "valid")[:, None] for line in lines)
    turns = np.linspace(0, 2 * np.pi, 65)
    offsets = np.broadcast_arrays(radius * np.cos(turns), -height, -radius * np.sin(turns))
    return sheet(at(x, y, d) + np.stack(offsets, -1) / (d + HORIZON), bsdf)


def ball(x: float, y: float, d: float, radius: float, bsdf: Part, **more: Any) -> Part:
    """A ball by its centre and radius in pixels."""
    return {"type": "sphere", "center": at(x, y, d).tolist(), "radius": radius / (d + HORIZON), "bsdf": bsdf, **more}


def box(x: float, y: float, d: float, sides: tuple[float, float, float], bsdf: Part, turn: float = 0.0) -> Part:
    """A box that stands on (x, y), by width, height and depth in pixels, turned about the vertical."""
    half = np.array(sides) / 2 / (d + HORIZON)
    centre = at(x, y, d) - [0, half[1], 0]
    place = (
        mi.ScalarTransform4f().translate(centre.tolist()).rotate([0, 1, 0], turn).scale([half[0], -half[1], half[2]])
    )
    return {"type": "cube", "to_world": place, "bsdf": bsdf}


def texture(colour: Any) -> Part:
    """A colour (r, g, b) or a picture [h, w, 3]."""
    if np.ndim(colour) == 1:
        return {"type": "rgb", "value": [float(part) for part in colour]}
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(colour, np.float32)), "raw": True}


def matte(colour: Any) -> Part:
    """A material that scatters evenly."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture(colour)}}


BLACK = matte((0, 0, 0))


def shiny(colour: Any, roughness: float = 0.1) -> Part:
    """A material under a clear coat."""
    coated = {"type": "roughplastic", "diffuse_reflectance": texture(colour), "alpha": roughness}
    return {"type": "twosided", "bsdf": coated}


def metal(name: str, roughness: float) -> Part:
    """A metal by the name of its optical constants."""
    return {"type": "twosided", "bsdf": {"type": "roughconductor", "material": name, "alpha": roughness}}


def glowing(colour: Any) -> Part:
    """A light for a `sheet`."""
    return {"type": "area", "radiance": texture(colour), "sampling_weight": 0.0}


def daylight(level: float) -> Scene:
    """Even light from everywhere, found by scattered rays alone; lights are only aimed at where there are others."""
    none = {"type": "point", "position": [0, 0, 0], "intensity": 0.0, "sampling_weight": 1e-6}
    return {"sky": {"type": "constant", "radiance": level, "sampling_weight": 0.0}, "none": none}


def globe(centre: NDArray, radius: float, colour: list[float]) -> Part:
    """A ball of light by its centre and radius in world units."""
    light = {"type": "area", "radiance": texture(colour), "sampling_weight": 0.3}
    return {"type": "sphere", "center": centre.tolist(), "radius": radius, "emitter": light}


def fractal(random: Generator, height: int, width: int, decay: float = 1.5) -> NDArray:
    """A random pattern [h, w, 1] of mean 0 and deviation 1 whose amplitudes fall with the power of the frequency."""
    frequencies = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)) * max(height, width)
    spectrum = np.fft.rfft2(random.standard_normal((height, width))) / np.maximum(frequencies, 1) ** decay
    spectrum[0, 0] = 0
    pattern = np.fft.irfft2(spectrum, (height, width))
    return (pattern / pattern.std())[..., None]


# Scenes


def hair(random: Generator) -> Scene:
    """Long hair before a bright background."""
    n, t = 1500, np.linspace(0, 1, 28)
    side, depth, loose = random.uniform(-1, 1, (n, 1)), random.uniform(0, 1, (n, 1)), random.random((n, 1)) < 0.25
    side = side * np.where(loose, random.uniform(1, 1.9, (n, 1)), 1)
    turn = np.clip(t * random.uniform(2.2, 3.2, (n, 1)), 0, np.pi / 2)
    wave = np.cumsum(np.cumsum(random.standard_normal((n, 28)), 1), 1) * np.where(loose, 0.22, 0.06)
    sway = (3 + 3 * depth) * np.sin(7 * t + 3 * side + random.uniform(0, 1.2, (n, 1))) * t
    x = 62 * side * np.sin(turn) * (1 + 0.25 * t) + sway + wave
    y = -72 + 46 * (1 - np.cos(turn)) * np.abs(side) + 190 * np.maximum(t - 0.05, 0) ** 1.2 - np.where(loose, 4, 0)
    d = 0.1 + 1.0 * np.sqrt(np.maximum(1 - side**2, 0.05)) * (0.75 + 0.25 * depth) * np.sin(turn * 0.8 + 0.3)
    radii = random.uniform(0.3, 0.55, (n, 1)) * np.where(t > 0.85, (1.02 - t) / 0.17, 1) / 4.8
    paths, parts = at(x, y, d), daylight(0.6)
    for tone in range(5):
        brown = shiny(np.array([0.30, 0.16, 0.08]) * (0.4 + 0.3 * tone), 0.25)
        parts[f"hair_{tone}"] = tubes(paths[tone::5], radii[tone::5], brown)
    glow = 0.8 + 0.13 * fractal(random, 96, 128, 1.7) * [0.6, 0.8, 1]
    glow = np.clip(glow + np.linspace(0.08, -0.3, 96)[:, None, None] * [1, 0.8, 0.3], 0.1, 1)
    return parts | {
        "wall": card(-220, -180, 220, 180, -1.4, BLACK, light=glowing(glow)),
        "head": ball(0, -20, 0.2, 40, matte((0.08, 0.04, 0.02))),
        "neck": lathe(0, 120, 0.1, "26 0 22 60 22 90", matte((0.5, 0.33, 0.25))),
    }


WORDS = """light field views slope focus plane lens depth aperture shift sum pixel blur edge noise filter ray scene
camera sharp picture the of and a through with from near far between every which where"""


def printed(random: Generator, title: str, lines: int, paper: ArrayLike, ink: ArrayLike, size: int = 28) -> NDArray:
    """A printed page [h, w, 3], with a title above lines of random words."""
    image = Image.new("L", (900, 1200), 0)
    draw, words = ImageDraw.Draw(image), WORDS.split()
    draw.text((60, 40), title, 255, ImageFont.load_default(130))
    for n in range(lines):
        line = " ".join(random.choice(words, 12)).capitalize()
        draw.text((60, 230 + n * size * 1.35), line[: int(1500 / size)], 255, ImageFont.load_default(size))
    share = np.asarray(image)[..., None] / 255.0
    return share * np.asarray(ink) + (1 - share) * np.asarray(paper)


def text(random: Generator) -> Scene:
    """Printed pages, slanted and upright."""
    cream, white, black = (0.82, 0.78, 0.66), (0.85, 0.85, 0.85), (0.04, 0.04, 0.05)
    page = printed(random, "Refocus", 26, cream, black)
    poster = printed(random, "SLOPE", 11, (0.1, 0.25, 0.5), white, 64)
    label = printed(random, "Exit 7", 12, (0.75, 0.2, 0.1), white, 60)
    slip = printed(random, "Views", 20, white, black, 34)
    plaster = np.clip(0.45 + 0.04 * fractal(random, 192, 256, 1), 0, 1) * [1, 0.95, 0.9]
    slant = [[-1.2, -1.2], [1.1, 1.1]]
    return {
        "wall": card(-260, -200, 260, 160, -1.5, matte(plaster)),
        "poster": card(-120, -112, -8, 30, -1.4, matte(poster)),
        "slip": card(20, -88, 100, 18, [[-1.0, -0.2], [-1.0, -0.2]], matte(slip)),
        "page": card(-92, -28, 52, 150, slant, matte(page)),
        "label": card(62, 4, 122, 84, 1.2, matte(label)),
    } | daylight(0.9)


def street(random: Generator) -> Scene:
    """A street at night, with lamps, windows and cars."""
    lit = random.random((14, 40, 1)) < 0.4
    warm = random.uniform(0.15, 0.9, (14, 40, 1)) * [1, 0.78, 0.45] * random.uniform(0.7, 1, (14, 40, 3))
    panes = np.kron(np.where(lit, warm, 0.012), np.ones((12, 12, 1)))
    frame = (np.arange(panes.shape[0]) % 12 < 4)[:, None] | (np.arange(panes.shape[1]) % 12 < 5)
    panes[frame] = 0.004
    scene = daylight(0.012) | {"road": ground(14.5, 2.9, -2.75, shiny((0.07, 0.07, 0.08), 0.18))}
    near, far = FOCAL / (2.9 + HORIZON), FOCAL / (-2.6 + HORIZON)
    for name, x in (("left", -20.0), ("right", 20.0)):
        ends = (near, far)[:: int(-np.sign(x))]
        wall = np.array([[[x, y, z] for z in ends] for y in (-75, 14.5)])
        scene[name] = sheet(wall, matte((0.16, 0.13, 0.11)), light=glowing(panes))
    lit = random.random((40, 60, 1)) < 0.25
    warm = random.uniform(0, 0.9, (40, 60, 1)) * random.uniform(0.7, 1, (40, 60, 3)) * [1, 0.75, 0.45]
    city = np.where(lit, warm, 0.008)
    scene["city"] = card(-60, -25, 60, 25, -2.6, BLACK, light=glowing(city))
    for n, d in enumerate((2.2, 1.1, 0.2, -0.7, -1.5, -2.1)):
        for x in (-14.0, 14.0):
            foot = np.array([x, 14.5, FOCAL / (d + HORIZON)])
            top = foot - [0, 26, 0]
            post = np.linspace(foot, top, 8)[None]
            scene[f"post_{n}_{x:.0f}"] = tubes(post, np.full((1, 8), 0.3), matte((0.2, 0.2, 0.2)), 10)
            scene[f"lamp_{n}_{x:.0f}"] = globe(top, 0.8, [5.0, 4.0, 2.4])
        colour = {"type": "rgb", "value": [170, 130, 80]}
        scene[f"bulb_{n}"] = {"type": "point", "position": [10.0, -9, float(top[2])], "intensity": colour}
    for n, (x, d) in enumerate([(-6.5, 0.7), (-6.0, -1.0), (6.0, -0.3), (6.5, -1.8), (-6.2, -2.0)]):
        z, colour = FOCAL / (d + HORIZON), [6.0, 5.6, 4.6] if x > 0 else [4.0, 0.15, 0.1]
        place = mi.ScalarTransform4f().translate([x, 11, z + 7]).scale([3.2, 2.6, 6])
        scene[f"car_{n}"] = {"type": "cube", "to_world": place, "bsdf": shiny((0.12, 0.12, 0.16), 0.1)}
        for side in (-2.3, 2.3):
            scene[f"car_{n}_{side:.0f}"] = globe(np.array([x + side, 11.5, z + 0.9]), 0.5, colour)
    return scene


def table(random: Generator, window: float) -> Scene:
    """A wooden table before a wall, in daylight with a window."""
    grain = fractal(random, 512, 32, 1.2).repeat(16, 1)[:, :512] + 0.4 * fractal(random, 512, 512, 1)
    wood = np.clip(np.array([0.42, 0.26, 0.14]) * (1 + 0.22 * grain), 0.02, 0.9).swapaxes(0, 1)
    room = np.full((32, 64, 3), 0.5) * np.linspace(1.5, 0.5, 32)[:, None, None]
    room[8:14, 6:14] = window * np.array([1, 1, 1.1])
    room[9:13, 46:49] = window * np.array([1, 0.84, 0.64])
    return {
        "table": ground(17.0, 2.0, -1.45, shiny(wood, 0.12)),
        "light": {"type": "envmap", "bitmap": mi.Bitmap(room.astype(np.float32)), "scale": 1.5},
    }


def glass(random: Generator) -> Scene:
    """Glasses and a ball of glass before a pattern."""
    clear: dict[str, Any] = {"type": "dielectric", "int_ior": 1.5}
    y, x = np.mgrid[:60, :80]
    coloured = random.uniform(0.1, 0.6, (12, 16, 3)).repeat(5, 0).repeat(5, 1)
    tiles = np.where(((x // 5 + y // 5) % 2 == 0)[..., None], [0.75, 0.72, 0.65], coloured)
    goblet = "0 0 20 0 20 2 3 4 2.5 34 10 40 23 56 24 74 20 96 19 96 22.5 74 21.5 57 9 43 0 40"
    tumbler = "0 0 17 0 21 52 19.5 52 16 6 0 6"
    bottle = "0 0 24 0 24 80 9 104 8 138 6.5 138 7 104 22 79 22 4 0 4"
    return table(random, 2.0) | {
        "wall": card(-220, -170, 220, 50, -1.45, matte(tiles)),
        "ball": ball(-66, 56, 1.1, 30, clear),
        "goblet": lathe(8, 79, 0.65, goblet, clear),
        "tumbler": lathe(76, 84, 0.95, tumbler, clear),
        "bottle": lathe(-20, 61, -0.4, bottle, clear | {"specular_transmittance": texture([0.7, 0.95, 0.75])}),
        "lemon": ball(50, 46, -0.4, 15, shiny((0.75, 0.6, 0.05), 0.2)),
        "plum": ball(104, 44, -0.6, 14, shiny((0.3, 0.05, 0.2), 0.2)),
    }


def grass(random: Generator) -> Scene:
    """Blades of grass and flowers before a sky."""
    n, t = 4000, np.linspace(0, 1, 9)
    d = random.uniform(-2.1, 2.6, (n, 1))
    x, height = random.uniform(-165, 165, (n, 1)), random.uniform(5, 16, (n, 1)) * (d + HORIZON)
    bend = random.normal(0.15, 0.35, (n, 1)) * height
    y = 15.0 * (d + HORIZON) - height * (t - 0.3 * t**2 * np.abs(bend / height))
    paths = at(x + bend * t**2, y, d + random.normal(0, 0.12, (n, 1)) * t)
    radii, along, scene = random.uniform(0.12, 0.3, (n, 1)) * (1.02 - t**2), t[:, None, None], daylight(1.1)
    for tone in range(6):
        green = [0.2, 0.36, 0.06] * np.array(0.5 + 0.2 * tone)
        blade = green * (0.35 + 0.9 * along) + 0.03 * tone * along * [1, 0.5, 0]
        scene[f"blades_{tone}"] = tubes(paths[tone::6], radii[tone::6], matte(blade), 3)
    for n in range(26):
        d, x, up = random.uniform(-1.6, 2.4), random.uniform(-120, 120), random.uniform(10, 17)
        foot, top = 15.0 * (d + HORIZON), (15.0 - up) * (d + HORIZON)
        colour = [(0.8, 0.06, 0.04), (0.85, 0.85, 0.8), (0.85, 0.65, 0.05)][n % 3]
        scene[f"flower_{n}"] = ball(x, top, d, 0.9 * (d + HORIZON), matte(colour))
        stem = at(x, np.linspace(foot, top, 9), d)[None]
        scene[f"stem_{n}"] = tubes(stem, np.full((1, 9), 0.12), matte((0.15, 0.3, 0.06)))
    sky = np.linspace(0, 1, 96)[:, None, None] * [0.35, 0.2, 0.02] + [0.4, 0.58, 0.85]
    hills = 62 + 5 * fractal(random, 8, 128, 1.5)[0, :, 0]
    trees = [0.1, 0.17, 0.09] + 0.03 * fractal(random, 96, 128, 0.7)
    sky = np.clip(np.where((np.arange(96)[:, None] > hills)[..., None], trees, sky), 0.01, 1)
    return scene | {
        "clouds": card(-200, -150, 200, 100, -2.4, BLACK, light=glowing(sky)),
        "soil": ground(15.0, 2.9, -2.3, matte((0.09, 0.07, 0.03))),
    }


def face(random: Generator) -> Scene:
    """A head as of clay or wax, with painted eyes, brows and lips."""
    rows, columns = 300, 240
    latitude, longitude = np.meshgrid(np.linspace(-1.45, 1.45, rows), np.linspace(-2.0, 2.0, columns), indexing="ij")
    x, y, z = np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)

    def spots(*each: tuple[float, ...]) -> NDArray:
        """Sum of soft spots of some height at (x, y), of some width and height; with x, at -x too."""
        parts = [(a, s * x0, y0, w, h) for a, x0, y0, w, h in each for s in ((1, -1) if x0 else (1,))]
        return sum(a * np.exp(-(((x - x0) / w) ** 2) - ((y - y0) / h) ** 2) for a, x0, y0, w, h in parts)[..., None]

    nose = (0.24, 0, 0.17, 0.13, 0.12), (0.13, 0, -0.05, 0.07, 0.22), (0.07, 0.11, 0.2, 0.06, 0.06)
    lips = (0.07, 0, 0.435, 0.22, 0.04), (0.08, 0, 0.53, 0.19, 0.05), (-0.04, 0, 0.48, 0.25, 0.018)
    eyes = (-0.16, 0.34, -0.1, 0.17, 0.12), (0.1, 0.34, -0.1, 0.13, 0.075), (0.06, 0.36, -0.24, 0.25, 0.06)
    pores, mottle = fractal(random, rows, columns, 0.6), fractal(random, rows, columns, 1.6)
    cheeks = (0.05, 0.5, 0.2, 0.25, 0.22), (0.12, 0, 0.8, 0.25, 0.14)
    form = (spots(*nose, *lips, *eyes, *cheeks) + 0.0008 * pores + 0.0018 * mottle)[..., 0]
    skin = [0.66, 0.42, 0.32] * (1 + 0.035 * pores + 0.05 * mottle)
    skin = skin + spots((0.1, 0.5, 0.22, 0.2, 0.18), (0.06, 0, 0.2, 0.12, 0.1)) * [0.6, -0.6, -0.4]
    for colour, less, *painted in (
        ((0.55, 0.16, 0.15), 0.5, (2.2, 0, 0.435, 0.2, 0.035), (2.2, 0, 0.53, 0.17, 0.04)),
        ((0.2, 0.05, 0.05), 0.6, (3, 0, 0.48, 0.22, 0.01)),
        ((0.1, 0.06, 0.04), 0.6, (3, 0.35, -0.27, 0.19, 0.03)),
        ((0.8, 0.78, 0.74), 3, (8, 0.34, -0.1, 0.105, 0.042)),
        ((0.1, 0.2, 0.28), 8, (20, 0.34, -0.1, 0.055, 0.055)),
        ((0.01, 0.01, 0.01), 8, (20, 0.34, -0.1, 0.03, 0.03)),
    ):
        share = np.clip(spots(*painted) - less, 0, 1)
        skin = (1 - share) * skin + share * colour
    scale = (1 + form) / (HORIZON + 0.3)
    points = at(0, 2, 0.3) + np.stack([66 * x, 84 * y, -75 * z], -1) * scale[..., None]
    room = np.full((32, 64, 3), 0.5)
    room[6:16, 8:20] = [3.6, 3.4, 3.2]
    wall = 0.3 + np.linspace(0.1, -0.12, 128)[:, None] * [1, 1, 1] + 0.02 * fractal(random, 96, 128, 1.2)
    return {
        "head": sheet(points, shiny(np.clip(skin, 0.005, 0.95), 0.35)),
        "neck": lathe(0, 150, 0.1, "50 0 34 30 32 90", shiny((0.6, 0.38, 0.29), 0.35)),
        "shirt": lathe(0, 190, 0.1, "130 0 120 70 60 92 40 96 36 90", matte((0.1, 0.18, 0.3))),
        "hair": ball(0, -14, 0.1, 80, matte((0.06, 0.035, 0.02))),
        "wall": card(-240, -180, 240, 180, -1.4, matte(np.clip(wall * [0.8, 0.95, 1], 0, 1))),
        "light": {"type": "envmap", "bitmap": mi.Bitmap(room.astype(np.float32))},
    }


def gloss(random: Generator) -> Scene:
    """Metal and lacquer with highlights."""
    vase = "0 0 20 0 33 36 26 70 11 90 19 108"
    tiles = np.kron((np.indices((10, 12)).sum(0) % 2)[..., None] * [0.5, 0.42, 0.35] + 0.12, np.ones((8, 8, 1)))
    room = table(random, 5.0)
    cloudy = np.clip(0.3 + 0.08 * fractal(random, 96, 128, 1.3) * [1, 0.8, 0.6], 0, 1)
    return room | {
        "table": ground(17.0, 2.0, -1.45, shiny(tiles, 0.08)),
        "wall": card(-220, -170, 220, 50, -1.45, matte(cloudy)),
        "gold": ball(-56, 53, 0.9, 30, metal("Au", 0.12)),
        "copper": lathe(-6, 71, 0.2, vase, metal("Cu", 0.2)),
        "chrome": ball(52, 49, 0.5, 27, metal("Cr", 0.04)),
        "lacquer": ball(96, 69, 1.1, 18, shiny((0.6, 0.02, 0.02), 0.05)),
        "pearl": ball(4, 78, 1.25, 11, shiny((0.75, 0.7, 0.68), 0.1)),
        "blue": lathe(-102, 61, -0.4, vase, shiny((0.03, 0.08, 0.5), 0.06)),
        "silver": lathe(78, 55, -0.75, "0 0 14 0 22 30 22 50 0 60", metal("Ag", 0.15)),
    }


def shelf(random: Generator) -> Scene:
    """Shelves full of books, balls and vases, at many depths."""
    scene = daylight(0.9) | {"back": card(-230, -170, 230, 170, -1.5, matte((0.35, 0.3, 0.25)))}
    wood = np.clip(np.array([0.5, 0.33, 0.2]) * (1 + 0.15 * fractal(random, 64, 256, 1)), 0, 1)
    for level, height in enumerate((-14.5, -4.0, 6.5, 17.5)):
        near, far = FOCAL / (0.45 + 0.3 * level + HORIZON), FOCAL / (HORIZON - 1.5)
        place = mi.ScalarTransform4f().translate([0, height + 0.4, (near + far) / 2]).scale([60, 0.4, (far - near) / 2])
        scene[f"board_{level}"] = {"type": "cube", "to_world": place, "bsdf": matte(wood)}
        x = -150.0
        while x < 150:
            d = random.uniform(-0.9, 0.3 + 0.3 * level)
            kind, colour = random.random(), random.dirichlet([1, 1, 1]) * random.uniform(0.3, 1.2)
            size, name = d + HORIZON, f"thing_{level}_{len(scene)}"
            y = height * size
            if kind < 0.6:
                spine = np.ones((40, 8, 1)) * colour
                spine[6:10], spine[26:34, 2:6] = random.uniform(0.1, 0.9, 3), random.uniform(0.1, 0.9, 3)
                width = random.uniform(1.6, 3.4) * size
                sides = (width, random.uniform(6, 9) * size, 4 * size)
                scene[name] = box(x, y, d, sides, matte(spine), random.normal(0, 6))
            elif kind < 0.8:
                width = 5.0 * size
                shape = "0 0 1.3 0 2.3 2.5 1.0 5.5 1.5 7"
                scene[name] = lathe(x + width / 3, y, d, shape, shiny(colour, 0.1), size)
            else:
                width = 4.5 * size
                scene[name] = ball(x + width / 3, y - 1.9 * size, d, 1.9 * size, shiny(colour, 0.15))
            x += width * random.uniform(0.75, 1.05)
    return scene


SCENES: dict[str, Callable[[Generator], Scene]] = {
    scene.__name__: scene for scene in (hair, text, street, glass, grass, face, gloss, shelf)
}

# Pictures


def rendered(scene: mi.Scene, depth: int, samples: int, seed: list[int], lens: tuple[float, ...]) -> NDArray:
    """Picture [3, H, W] of a lens: p, q of the middle of its square aperture, slope of its focus, width."""
    integrator, (height, columns) = mi.load_dict({"type": "path", "max_depth": depth}), SIZE
    p, q, slope, width = (dr.opaque(mi.Float, float(number)) for number in lens)
    total = np.zeros((3, height, columns))
    for key in np.random.SeedSequence(seed).generate_state(samples // AT_ONCE):
        sampler = mi.load_dict({"type": "multijitter", "sample_count": AT_ONCE})
        sampler.set_samples_per_wavefront(AT_ONCE)
        sampler.seed(dr.opaque(mi.UInt, int(key)), height * columns * AT_ONCE)
        pixel = dr.arange(mi.UInt, height * columns * AT_ONCE) // AT_ONCE
        offset, place = sampler.next_2d(), (sampler.next_2d() - 0.5) * width + mi.Point2f(p, q)
        x = mi.Float(pixel % columns) + offset.x - columns / 2
        y = mi.Float(pixel // columns) + offset.y - height / 2
        # The aperture's points stand at (-p, -q), since a main lens inverts it; in the plane of focus, all see (x, y).
        towards = mi.Vector3f(x, y, FOCAL) / (slope + HORIZON) + mi.Vector3f(place.x, place.y, 0)
        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(-place.x, -place.y, 0), dr.normalize(towards)))
        light = integrator.sample(scene, sampler, ray)[0]
        total += [np.array(dr.block_sum(channel, AT_ONCE)).reshape(SIZE) for channel in light]
    return (total / samples).astype(np.float32)


def slopes_of(name: str) -> Tensor:
    """Slopes of a scene's truth, [16]."""
    return SETTINGS[name]["first"] + SETTINGS[name]["step"] * torch.arange(N_PLANES, dtype=torch.float64)


def shots(name: str) -> list[tuple[Path, tuple[float, ...], int]]:
    """Files of a scene's pictures, views first and then both truths, with their lenses and samples per pixel."""
    folder, own, half = CACHE / name, SETTINGS[name], GRID // 2
    views = [(n % GRID - half, n // GRID - half, 0.0, 0.0) for n in range(GRID**2)]
    truth = [(0.0, 0.0, slope, float(GRID)) for slope in slopes_of(name).tolist()]
    found = [(folder / f"view_{n:02}.npy", lens, own["view_samples"]) for n, lens in enumerate(views)]
    for run in (1, 2):
        found += [(folder / f"truth_{run}_{n:02}.npy", lens, own["truth_samples"]) for n, lens in enumerate(truth)]
    return found


def built_world(name: str) -> mi.Scene:
    """A scene for Mitsuba; it is built by one thread, since normals of meshes are sums in the order of threads."""
    threads = dr.thread_count()
    dr.set_thread_count(1)
    world = mi.load_dict({"type": "scene", **SCENES[name](np.random.default_rng(SETTINGS[name]["seed"]))})
    dr.sync_thread()
    dr.set_thread_count(threads)
    return world


def render(names: list[str]) -> None:
    """Render all pictures that are not in the cache."""
    jobs = [(name, n, *shot) for name in names for n, shot in enumerate(shots(name)) if not shot[0].is_file()]
    world, built = None, ""
    for name, n, file, lens, samples in (progress := tqdm(jobs, smoothing=0.05)):
        own = SETTINGS[name]
        progress.set_description(f"{name} {file.stem}")
        if built != name:
            world, built = built_world(name), name
        with atomic.replacing(file) as partial:
            np.save(partial, rendered(world, own["depth"], samples, [own["seed"], n], lens))


def judged(name: str) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Views [7, 7, 3, H, W] of a rendered scene, slopes [16], and two truths [16, 3, H, W] of independent noise."""
    pictures = torch.from_numpy(np.stack([np.load(file) for file, *_ in shots(name)]))
    views, first, second = pictures.split([GRID**2, N_PLANES, N_PLANES])
    return views.unflatten(0, (GRID, GRID)), slopes_of(name), first, second


def checksums(names: list[str]) -> None:
    """Write the SHA-256 of each complete scene into the record, and say whether it is as before."""
    for name in names:
        files = [file for file, *_ in shots(name)]
        if all(file.is_file() for file in files):
            digest = hashlib.sha256(b"".join(np.load(file).tobytes() for file in files)).hexdigest()
            print(f"{name}: {'as recorded' if digest == SETTINGS[name]['sha256'] else 'recorded anew'}")
            SETTINGS[name]["sha256"] = digest
    rows = ",\n".join(f' "{name}": {json.dumps(own)}' for name, own in SETTINGS.items())
    atomic.write_text(RECORD, f"{{\n{rows}\n}}\n")


# Scores


def joint_wiener(views: Tensor, slopes: Tensor) -> Tensor:
    """Filters of all views together, by the disparity map that the views show."""
    scene = lfref.analyze_scene(views)
    prior = prior_of_map(scene.disparity, scene.widest, scene.noise)
    return refocus_jointly(views, slopes, prior, torch.full((GRID, GRID), 1 / GRID**2, dtype=torch.float64))


METHODS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "mean": mean_of_views,
    "linear": lfref.shift_and_sum,
    "cubic": lambda views, slopes: lfref.shift_and_sum(views, slopes, "cubic"),
    "cells": lfref.shift_and_sum_antialiased,
    "layers": lfref.refocus_by_layers,
    "joint": joint_wiener,
    "separable": lfref.separable_wiener,
    "blockwise": lfref.blockwise_wiener,
}


def score(stack: Tensor, first: Tensor, second: Tensor) -> float:
    """Mean PSNR of a stack [16, 3, H, W] inside the border, each plane capped; the noise of the truths cancels."""
    product = ((stack - first).double() * (stack - second))[..., BORDER:-BORDER, BORDER:-BORDER]
    return float((-10 * product.mean((1, 2, 3)).clamp(min=10 ** (-MEAN_CAP_DB / 10)).log10()).mean())


def complete() -> list[str]:
    """Names of the scenes that are complete."""
    return [name for name in SCENES if all(file.is_file() for file, *_ in shots(name))]


@torch.no_grad()
def score_table() -> Iterator[str]:
    """Scores of the methods on the scenes that are complete, clean and in noise."""
    yield from pages.head("scene", *METHODS)
    for sigma, kind in ((0.0, ""), (NOISE, f", noise {NOISE:g}")):
        rows = []
        for name in complete():
            views, slopes, first, second = judged(name)
            views = views + sigma * torch.randn(views.shape, generator=torch.Generator().manual_seed(0))
            rows.append([score(method(views, slopes), first, second) for method in METHODS.values()])
            if not sigma:
                yield pages.row(name, *(f"{value:.2f}" for value in rows[-1]))
        yield pages.row("mean" + kind, *(f"{value:.2f}" for value in np.mean(rows, 0)))


@torch.no_grad()
def gallery(names: list[str]) -> None:
    """Write pictures of scenes for docs/gallery.md: focused far, in the middle and near, side by side."""
    for name in names:
        views = judged(name)[0]
        low, high = lfref.inspect(lfref.LightField(views)).slopes or (-1.0, 1.0)
        far, middle, near = lfref.blockwise_wiener(views, [low, (low + high) / 2, high])
        gap = torch.ones(3, SIZE[0], 6)
        row = torch.cat([far, gap, middle, gap, near], 2)
        images.write_image(pages.PICTURES / f"gallery_{name}.jpg", for_display(row), quality=88)


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", choices=("render", "checksums", "score", "gallery"))
    parser.add_argument("names", nargs="*", metavar="SCENE", choices=[[], *SCENES], help="scenes to render; none: all")
    given = parser.parse_args()
    if given.command == "score":
        pages.fill({"judges": score_table()})
    else:
        {"render": render, "checksums": checksums, "gallery": gallery}[given.command](given.names or list(SCENES))


if __name__ == "__main__":
    main()
