"""Simulated light fields that several tests look at, rendered once."""

import dataclasses
import functools

from lfref.captures.estimates import Estimates
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat

ODD = ("gloss", "window", "mirror", "lamps", "running", "twigs", "thicket")
"""Scenes of which views differ for other reasons than a defect."""


@functools.cache
def clean(name: str) -> LightField:
    """A scene of sim30 without its sensor."""
    return _seen(dataclasses.replace(sim30.SCENES[name], sensor=Sensor()))


@functools.cache
def recorded(name: str, **effects: object) -> LightField:
    """A scene of sim30 through a sensor: its own, or one with these effects."""
    scene = sim30.SCENES[name]
    return _seen(dataclasses.replace(scene, sensor=Sensor(**effects)) if effects else scene)


@functools.cache
def white(name: str) -> LightField:
    """A white wall through the camera and sensor of a scene."""
    surfaces = (Surface(Plane(0.0), Flat((0.8, 0.8, 0.8))),)
    scene = sim30.SCENES[name]
    return _seen(Scene(scene.camera, surfaces, sensor=scene.sensor, seed=5))


def estimates(field: LightField, white: LightField | None = None) -> Estimates:
    """What a correction is given."""
    return Estimates(field, white)


def _seen(scene: Scene) -> LightField:
    return LightField(simulate(scene, outputs=("views",), slopes=[0.0]).views, scene.name)
