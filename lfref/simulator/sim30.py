"""sim30: thirty fixed scenes with everything that the simulator can show, the counterpart of the 30 Scenes test set.

Their disparities lie among the slopes of the paper's planes in either convention, most of them between -1 and 0.5
pixels per view step. Figures are comparable only between equal `VERSION`s. In version 1, painted surfaces have no
frequencies above half a cycle per pixel. In version 2, cameras average over several samples per pixel, so that textures
and edges have higher ones and views alias, as in photographs. `WIDE` are ten more scenes, of wide baselines.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

from lfref.errors import chosen
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import Clipping, Exposure, Mosaic, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.recording import Noise as SensorNoise
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.materials import Emissive, Glass, Glossy, Mirror
from lfref.simulator.mattes import Disc, Full, Leaf, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.scenes import Fixed
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Gradient, Noise, Stripes

CAMERA = Camera(grid=(7, 7), size=(128, 192))
ROUND = dataclasses.replace(CAMERA, aperture="disc")
DAY = Light()
IDEAL = Sensor()

# Parts that several scenes share.
STONE = Noise((0.45, 0.43, 0.40), (0.25, 0.25, 0.25), exponent=1.2)
MOSS = Noise((0.25, 0.40, 0.20), (0.18, 0.22, 0.15), exponent=1.4, hardness=0.5)
BARK = Noise((0.35, 0.25, 0.17), (0.20, 0.16, 0.12), exponent=1.1, hardness=0.6)
SKY = Gradient(260, (0.35, 0.50, 0.75), (0.85, 0.88, 0.92), angle=90, phase=0.25)
CLOTH = Checker(16, (0.75, 0.15, 0.12), (0.90, 0.86, 0.78), angle=12)
LINES = Stripes(9, (0.08, 0.08, 0.10), (0.92, 0.92, 0.88), angle=65)
PAPER = Flat((0.85, 0.84, 0.80))
WALL = Surface(Plane(-1.0), STONE)
GARDEN = Surface(Plane(-0.6), MOSS)
LEAVES = (
    Surface(Plane(-0.2), MOSS, Leaf(90, 30, 25, (-40, 10))),
    Surface(Plane(0.15), BARK, Leaf(80, 26, -50, (35, -15))),
    Surface(Plane(0.4), MOSS, Leaf(110, 34, 80, (60, 20))),
)
TWIGS = (
    Surface(Plane(0.0), BARK, Twigs(45, 4, 4, -80, (-45, 70), seed=3)),
    Surface(Plane(0.4), BARK, Twigs(55, 3, 5, -100, (40, 72), seed=8)),
)
FENCE = Surface(Plane(0.3), CLOTH, Perforated(pitch=26, radius=10, angle=20))
BALL = Dome(-0.3, 0.6, 60, (10, 5))
CARDS = (
    WALL,
    Surface(Plane(-0.3), CLOTH, Polygon(((-75, -40), (-5, -50), (5, 35), (-70, 45)))),
    Surface(Plane(0.25), LINES, Disc(30, (45, 8))),
)
LAMPS = (
    Surface(Plane(-0.9), PAPER, Disc(4, (-60, -30)), Emissive(6)),
    Surface(Plane(-0.9), Flat((1.0, 0.6, 0.2)), Disc(3, (-10, -45)), Emissive(8)),
    Surface(Plane(-0.6), Flat((0.3, 0.7, 1.0)), Disc(5, (40, -20)), Emissive(4)),
)
SHINE = Glossy(strength=0.7, width=10, drift=3, centre=(5, 0))


def _scene(name: str, *surfaces: Surface, camera: Camera = CAMERA, light: Light = DAY, sensor: Sensor = IDEAL) -> Scene:
    return Scene(camera, surfaces, light, sensor, name)


SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        # Matte planes that face the camera and hide each other.
        _scene("plane", Surface(Plane(-1 / 3), STONE)),
        _scene("stripes", Surface(Plane(-0.6), LINES)),
        _scene("edge", WALL, Surface(Plane(0.0), CLOTH, Polygon(((0, -200), (300, -200), (300, 200), (0, 200))))),
        _scene("discs", GARDEN, *(Surface(Plane(d), LINES, Disc(22, (130 * d, 50 * d))) for d in (-0.35, 0.1, 0.45))),
        _scene("shards", WALL, *CARDS[1:2], Surface(Plane(0.2), MOSS, Polygon(((-30, 50), (20, -55), (75, 30))))),
        _scene("leaves", WALL, *LEAVES),
        _scene("twigs", Surface(Plane(-1.0), SKY), *TWIGS),
        _scene("lattice", GARDEN, FENCE),
        _scene("thicket", WALL, *LEAVES[:2], *TWIGS, FENCE),
        _scene("deep", Surface(Plane(-3.0), STONE), Surface(Plane(-5 / 3), MOSS, Leaf(150, 60, 10)), *TWIGS[1:]),
        # Slanted planes, and curved surfaces.
        _scene("floor", Surface(Plane(-0.3, (0.0, 0.008)), CLOTH)),
        _scene("wall", Surface(Plane(-0.25, (0.006, -0.002)), LINES), *TWIGS[1:]),
        _scene("crossing", Surface(Plane(-0.3, (0.006, 0.0)), STONE), Surface(Plane(-0.3, (-0.006, 0.001)), CLOTH)),
        _scene("dome", Surface(BALL, CLOTH)),
        _scene("hollow", Surface(Dome(0.2, -0.9, 80), STONE), *LEAVES[2:]),
        # Materials, light, opacity and motion.
        _scene("gloss", Surface(Plane(-0.4), BARK, material=Glossy(strength=0.6, width=14, drift=4)), *LEAVES[:1]),
        _scene("apple", WALL, Surface(BALL, Flat((0.55, 0.08, 0.06)), Disc(52, (10, 5)), SHINE)),
        _scene("window", GARDEN, Surface(Plane(0.1), PAPER, Disc(55), Glass(0.3, LINES, -1.0), opacity=0.1)),
        _scene("mirror", WALL, Surface(Plane(0.0), PAPER, Leaf(150, 80, 15), Mirror(0.85, CLOTH, -0.8))),
        _scene("lamps", Surface(Plane(-1.0), STONE), *LAMPS, light=Light(0.3)),
        _scene("bokeh", WALL, *LAMPS, *TWIGS[1:], camera=ROUND, light=Light(0.4), sensor=Sensor(clipping=Clipping())),
        _scene("veil", WALL, LEAVES[0], Surface(Plane(0.3), CLOTH, Disc(50, (10, 0)), opacity=0.5)),
        _scene("running", WALL, Surface(Plane(0.1), CLOTH, Disc(30, (-15, 0)), motion=(14.0, 3.0)), *TWIGS[:1]),
        # Optics and sensor; without them, these scenes differ as all others do.
        _scene("vignetting", *CARDS, sensor=Sensor(vignetting=Vignetting(field=0.6, cats_eye=0.5))),
        _scene(
            "colours",
            GARDEN,
            Surface(Plane(-0.25), LINES, Polygon(((-80, -45), (-15, -52), (-25, 40), (-70, 48)))),
            Surface(Plane(0.3), CLOTH, Disc(34, (40, -6))),
            sensor=Sensor(chromatic=Chromatic(magnification=(1.004, 1, 0.996), disparity=(0.05, 0, -0.05))),
        ),
        _scene(
            "misaligned",
            WALL,
            Surface(Plane(-0.45), BARK, Disc(40, (-35, 0))),
            Surface(Plane(0.1), LINES, Leaf(120, 50, 20, (30, 10))),
            sensor=Sensor(misalignment=Misalignment(sigma=0.25)),
        ),
        _scene(
            "crosstalk",
            Surface(Plane(-0.8), LINES),
            Surface(Plane(-0.1), MOSS, Leaf(130, 60, -15, (-20, 0))),
            Surface(Plane(0.35), PAPER, Disc(20, (55, -20))),
            sensor=Sensor(crosstalk=Crosstalk(leak=0.08)),
        ),
        _scene(
            "grainy",
            WALL,
            Surface(Plane(-0.4), PAPER, Polygon(((-70, 50), (-35, -45), (20, -50), (10, 52)))),
            Surface(Plane(0.2), CLOTH, Perforated(pitch=34, radius=12, angle=-10)),
            sensor=Sensor(mosaic=Mosaic(), noise=SensorNoise(shot=2e-3, read=1e-4), clipping=Clipping()),
        ),
        _scene(
            "graded",
            Surface(Plane(-0.7), SKY),
            Surface(
                Plane(-0.35), STONE, Polygon(((-200, 200), (-200, 10), (-60, -35), (20, 5), (90, -25), (200, 200)))
            ),
            Surface(Plane(0.2), MOSS, Polygon(((-200, 200), (-200, 35), (-20, 50), (60, 20), (200, 30), (200, 200)))),
            sensor=Sensor(
                exposure=Exposure(gain=0.8),
                quantisation=Quantisation(bits=8),
                white_balance=WhiteBalance(gains=(1.2, 1.0, 0.8)),
                tone_curve=ToneCurve("srgb"),
            ),
        ),
        _scene(
            "everything",
            Surface(Plane(-0.9, (0.002, 0.001)), STONE),
            *LAMPS[1:2],
            Surface(Plane(-0.5), PAPER, Leaf(120, 60, 15, (-40, 10)), Mirror(0.8, CLOTH, -0.8)),
            Surface(Dome(-0.3, 0.6, 50, (30, 10)), BARK, Disc(40, (30, 10)), SHINE),
            Surface(Plane(0.1), MOSS, Leaf(80, 26, -50, (-50, -15)), motion=(5.0, -2.0)),
            Surface(Plane(0.35), PAPER, Disc(30, (60, -20)), Glass(0.3, LINES, -1.0), opacity=0.2),
            *TWIGS[1:],
            camera=ROUND,
            light=Light(0.9, (1.0, 0.95, 0.85)),
            sensor=Sensor(
                chromatic=Chromatic(magnification=(1.002, 1, 0.998), disparity=(0.02, 0, -0.02)),
                vignetting=Vignetting(field=0.4, cats_eye=0.3),
                misalignment=Misalignment(sigma=0.1),
                crosstalk=Crosstalk(leak=0.04),
                exposure=Exposure(gain=0.9),
                mosaic=Mosaic(),
                noise=SensorNoise(shot=1e-3, read=1e-5),
                clipping=Clipping(),
                quantisation=Quantisation(bits=12),
                white_balance=WhiteBalance(gains=(1.1, 1.0, 0.9)),
                tone_curve=ToneCurve("srgb"),
            ),
        ),
    )
}


def _wide(name: str, grid: tuple[int, int], size: tuple[int, int], ends: tuple[float, float], *shares: float) -> Scene:
    """Surfaces between two disparities, each at a share of the way from the far one to the near one."""
    parts = (
        (STONE, Full()),
        (MOSS, Leaf(110, 40, 25, (-40, 10))),
        (CLOTH, Polygon(((-75, -60), (-5, -70), (5, 15), (-70, 25)))),
        (LINES, Disc(30, (60, 8))),
        (BARK, Twigs(45, 4, 5, -80, (30, 90), seed=3)),
    )
    far, near = ends
    surfaces = [
        Surface(Plane(far + share * (near - far)), texture, matte)
        for (texture, matte), share in zip(parts, shares, strict=True)
    ]
    return _scene(name, *surfaces, camera=Camera(grid, size))


WIDE: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        # Disparities to 8 pixels per view step.
        _wide("wide_near_5", (5, 5), (160, 240), (0, 8), 0, 0.3, 0.6, 0.8, 1),
        _wide("wide_both_5", (5, 5), (160, 240), (-8, 8), 0, 0.3, 0.6, 0.8, 1),
        _wide("wide_both_7", (7, 7), (192, 256), (-2, 8), 0, 0.2, 0.4, 0.7, 1),
        _wide("wide_far_7", (7, 7), (192, 256), (-8, -2), 0, 0.25, 0.5, 0.75, 1),
        _wide("wide_near_9", (9, 9), (192, 256), (0, 8), 0, 0.3, 0.6, 0.8, 1),
        _wide("wide_near_17", (17, 17), (192, 256), (0, 5), 0, 0.3, 0.6, 0.8, 1),
        # Disparities to 20 pixels per view step, as of a gantry.
        _wide("wide_gantry_5", (5, 5), (288, 384), (2, 20), 0, 0.3, 0.6, 0.8, 1),
        _wide("wide_steps_5", (5, 5), (288, 384), (4, 16), 0, 0.1, 0.5, 0.9, 1),
        _wide("wide_gantry_7", (7, 7), (288, 384), (4, 14), 0, 0.3, 0.6, 0.8, 1),
        _wide("wide_gantry_9", (9, 9), (288, 384), (1.4, 17.8), 0, 0.3, 0.6, 0.8, 1),
    )
}
"""Scenes whose views lie far apart, as those of camera arrays and gantries; they have no sensor. By name."""
ALIASED = 2
"""Samples along each axis of a pixel in version 2: details end at one cycle per pixel."""
VERSIONS: dict[str, dict[str, Scene]] = {
    "1": SCENES,
    "2": {
        name: dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, samples=ALIASED))
        for name, scene in SCENES.items()
    },
}
VERSION = "aa53f9c0373a"
"""Identifier of the pictures of version 1, views and truth, to be changed when they change;
tests/simulator/test_sim30.py compares them."""
VERSION_2 = "5d1c7b64e9f2"


def scenes(name: str | None = None, camera: Camera | Mapping[str, Any] | None = None, version: int = 1) -> Fixed:
    """The thirty scenes of version 1 (band-limited textures) or 2 (aliased textures), or the one of a name.

    A camera, or values of its fields that are not None, replaces the scenes' own; its size may show more or less.
    """
    known = chosen("version of sim30", str(version), VERSIONS)
    selected = tuple(known.values()) if name is None else (chosen("sim30 scene", name, known),)
    fields = vars(camera) if isinstance(camera, Camera) else camera or {}
    changes: Any = {name: value for name, value in fields.items() if value is not None}
    cameras = (dataclasses.replace(scene.camera, **changes) for scene in selected)
    return Fixed(tuple(dataclasses.replace(scene, camera=own) for scene, own in zip(selected, cameras, strict=True)))
