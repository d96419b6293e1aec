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
from lfref.simulator.effects.crosstalk import Crosstalk
from lfref.simulator.effects.displacement import Misalignment
from lfref.simulator.effects.mosaic import Mosaic
from lfref.simulator.effects.noise import Noise as SensorNoise
from lfref.simulator.effects.response import Clipping, Exposure, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import EFFECTS, Sensor
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.materials import Emissive, Glass, Glossy, Matte, Mirror
from lfref.simulator.mattes import Disc, Polygon
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat, Noise, Stripes

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


def vignetting() -> Figure:
    """Light that a lens keeps from the corners, in the view in the corner of the aperture."""
    return _changes(Vignetting(0.7), Vignetting(cats_eye=0.7))


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
    f"simulator_{draw.__name__}.jpg": draw for draw in (materials, vignetting, lenslets, sensor)
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
