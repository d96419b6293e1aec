"""Simulated light fields that several tests use, rendered once, and the estimates that corrections start from."""

import dataclasses
import functools

from lfref.captures import brightness, registration
from lfref.captures.correct import central_view
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
    return _rendered(dataclasses.replace(sim30.SCENES[name], sensor=Sensor()))


@functools.cache
def recorded(name: str) -> LightField:
    """A scene of sim30 through its sensor."""
    return _rendered(sim30.SCENES[name])


@functools.cache
def white(name: str) -> LightField:
    """A white wall through the camera and sensor of a scene."""
    surfaces = (Surface(Plane(0.0), Flat((0.8, 0.8, 0.8))),)
    scene = sim30.SCENES[name]
    return _rendered(Scene(scene.camera, surfaces, sensor=scene.sensor, seed=5))


def view(field: LightField):
    """Disparity and place of the central view, as arguments of estimates."""
    return {"disparity": central_view(field).disparity, "reference": central_view(field).reference}


def ratios(field: LightField):
    """Brightness of the views over that of the central one."""
    return brightness.ratios(field, *view(field).values())


def registered(field: LightField):
    """Patches of the views and their displacements."""
    return registration.register(field, *view(field).values())


@functools.cache
def registered_clean(name: str):
    """The same of a clean scene, once."""
    return registered(clean(name))


def _rendered(scene: Scene) -> LightField:
    return LightField(simulate(scene, outputs=("views",), slopes=[0.0]).views, scene.name)
