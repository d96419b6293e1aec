"""Draw what a simulated scene may have, each off and on: surfaces, textures, outlines, materials, optics, sensor.

Pictures of `simulator.md`. Letters: `v u` view row and column.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import sheets
from matplotlib.figure import Figure
from torch import Tensor

import lfref
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import Clipping, Exposure, Mosaic, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.recording import Noise as SensorNoise
from lfref.simulator.effects.sensor import EFFECTS, Sensor
from lfref.simulator.materials import Emissive, Glass, Glossy, Matte, Mirror
from lfref.simulator.mattes import Disc, Full, Leaf, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Gradient, Noise, Stripes

CAMERA = Camera(size=(96, 144))
MIDDLE, LEFT, RIGHT, CORNER = (3, 3), (3, 0), (3, 6), (0, 0)
PLASTER = Noise((0.45, 0.43, 0.40), (0.2, 0.2, 0.2), exponent=2.0, grain=0.005)
CLOTH = Checker(16.0, (0.75, 0.15, 0.12), (0.90, 0.86, 0.78), angle=12)
LINES = Stripes(9.0, (0.10, 0.20, 0.40), (0.92, 0.92, 0.88), angle=65)
WALL = Surface(Plane(-0.8), PLASTER)
CARD = Surface(Plane(0.2), CLOTH, Polygon(((-60, -34), (0, -40), (8, 30), (-54, 36))))
LID = Surface(Plane(0.8), LINES, Disc(24, (34, 8)))
DAY, DUSK, IDEAL = Light(), Light(0.6), Sensor()
CHANGE: dict[str, Any] = {"cmap": "magma", "vmin": 0, "vmax": 0.3}
DEPTH: dict[str, Any] = {"cmap": "viridis", "vmin": -1, "vmax": 1}


def surfaces() -> Figure:
    """The kinds of geometry, and the disparity of each."""
    kinds = (Plane(-0.4), Plane(0.0, (0.004, 0.009)), Dome(-0.4, 1.2, 45))
    scenes = [Scene(CAMERA, (Surface(kind, CLOTH),)) for kind in kinds]
    results = [lfref.simulate(scene, outputs=("views", "disparity")) for scene in scenes]
    titles = ("Plane", "Plane with a gradient", "Dome")
    seen = [(title, result.views[CORNER]) for title, result in zip(titles, results, strict=True)]
    depths = [("", result.disparity) for result in results]
    return sheets.sheet([*seen, *depths], bar="disparity, px per view step", **DEPTH)


def textures() -> Figure:
    """The kinds of texture."""
    kinds = (
        Flat((0.3, 0.5, 0.7)),
        Gradient(150, (0.2, 0.3, 0.7), (0.9, 0.8, 0.6), angle=20),
        LINES,
        CLOTH,
        Noise((0.4, 0.45, 0.3), (0.25, 0.25, 0.2), hardness=0.0),
        Noise((0.4, 0.45, 0.3), (0.25, 0.25, 0.2), hardness=1.0),
    )
    titles = ("Flat", "Gradient", "Stripes", "Checker", "Noise(hardness=0)", "Noise(hardness=1)")
    return sheets.sheet((title, _view(Surface(Plane(0.0), kind))) for title, kind in zip(titles, kinds, strict=True))


def outlines() -> Figure:
    """The kinds of outline, before a wall."""
    kinds = (
        Full(),
        Disc(36),
        Polygon(((-50, 30), (-10, -40), (10, 10), (55, -20), (30, 40))),
        Leaf(120, 50, angle=20),
        Twigs(34, 3, 5, foot=(0, 46), seed=8),
        Perforated(26, 9, angle=20),
    )
    return sheets.sheet((type(kind).__name__, _view(WALL, Surface(Plane(0.5), CLOTH, kind))) for kind in kinds)


def materials() -> Figure:
    """Each material as matte, and as it looks from the left and from the right."""
    return sheets.sheet(
        cell
        for surface in (
            Surface(Plane(0.2), Flat((0.5, 0.1, 0.08)), Disc(40), Glossy(0.8, 10, 4)),
            Surface(Plane(0.2), Flat((0.5, 0.5, 0.5)), Disc(40), Mirror(0.85, CLOTH, -2.0)),
            Surface(Plane(0.2), Flat((0.5, 0.5, 0.5)), Disc(40), Glass(0.3, CLOTH, -2.0), opacity=0.1),
            Surface(Plane(0.2), Flat((0.9, 0.6, 0.2)), Disc(12), Emissive(1.0)),
        )
        for cell in _from_both_sides(surface)
    )


def light_and_motion() -> Figure:
    """Changes of a scene before any camera: light, opacity, motion."""
    moved, thin = dataclasses.replace(LID, motion=(16.0, 4.0)), dataclasses.replace(LID, opacity=0.5)
    return sheets.sheet(
        [
            ("opacity=0.5", _view(WALL, CARD, thin)),
            ("motion=(16, 4)", _view(WALL, CARD, moved)),
            ("Light(0.8, (1, 0.8, 0.5))", _view(WALL, CARD, LID, light=Light(0.8, (1.0, 0.8, 0.5)))),
        ]
    )


def vignetting() -> Figure:
    """Light that a lens keeps from the corners, in the view in the corner of the aperture."""
    return _changes(Vignetting(0.7), Vignetting(cats_eye=0.7))


def chromatic() -> Figure:
    """Colours of different size and focus, in the same view."""
    return _changes(Chromatic((1.02, 1.0, 0.98)), Chromatic(disparity=(0.4, 0.0, -0.4)))


def lenslets() -> Figure:
    """Lenslets beside their places, and light that goes into the neighbouring view."""
    return _changes(Misalignment(0.5), Crosstalk(0.3))


def sensor() -> Figure:
    """Part of the middle view with each effect of the sensor and of its software."""
    effects = (
        Exposure(0.5),
        Mosaic("BGGR"),
        SensorNoise(0.003, 3e-4),
        Clipping(0.3, 0.7),
        Quantisation(3),
        WhiteBalance((1.2, 1.0, 0.6)),
        ToneCurve("srgb"),
    )
    shown = [("\noff", IDEAL), *((_named(effect), _sensor(effect)) for effect in effects)]
    part = (..., slice(20, 76), slice(44, 128))
    return sheets.sheet([(title, _view(WALL, CARD, LID, sensor=on)[part]) for title, on in shown], 4)


PICTURES: dict[str, Callable[[], Figure]] = {
    f"simulator_{draw.__name__}.jpg": draw
    for draw in (surfaces, textures, outlines, materials, light_and_motion, vignetting, chromatic, lenslets, sensor)
}


def _view(*surfaces: Surface, view: tuple[int, int] = MIDDLE, light: Light = DAY, sensor: Sensor = IDEAL) -> Tensor:
    """One view of a scene, [3, H, W]."""
    scene = Scene(CAMERA, surfaces, light, sensor)
    return lfref.simulate(scene, outputs=("views",)).views[view]


def _changes(*effects: Any) -> Figure:
    """Effects off, on, and what they change in the view in the corner."""
    off = _view(WALL, CARD, LID, view=CORNER)
    cells = []
    for effect in effects:
        on = _view(WALL, CARD, LID, view=CORNER, sensor=_sensor(effect))
        cells += [("\noff", off), (_named(effect), on), ("\nchange", (on - off).abs().mean(0))]
    return sheets.sheet(cells, bar="absolute change", **CHANGE)


def _sensor(*effects: Any) -> Sensor:
    """A sensor with these effects."""
    names = {kind: name for name, kind in EFFECTS.items()}
    return Sensor(**{names[type(effect)]: effect for effect in effects})


def _from_both_sides(surface: Surface) -> list[tuple[str, Tensor]]:
    """A surface in dim light, of paper, and as it is, from the left and the right."""
    paper = dataclasses.replace(surface, material=Matte(), opacity=1.0)
    name = type(surface.material).__name__
    shown = (("Matte", paper, MIDDLE), (f"{name}, from the left", surface, LEFT), ("from the right", surface, RIGHT))
    return [(title, _view(WALL, one, view=view, light=DUSK)) for title, one, view in shown]


def _named(value: Any) -> str:
    """A description in two lines: its kind, and what is not as usual in it."""
    fields = [field for field in dataclasses.fields(value) if getattr(value, field.name) != field.default]
    return f"{type(value).__name__}\n{', '.join(f'{field.name} {getattr(value, field.name)}' for field in fields)}"
