"""The picture of a white scene by which a camera is calibrated: it shows the vignetting of every view."""

import torch

from lfref.lightfield import LightField
from lfref.simulator.effects import chain
from lfref.simulator.scene import Scene

WHITE = 0.8
"""Radiance of the white scene."""


def white_picture(scene: Scene, light: LightField) -> LightField:
    """What the camera of a scene records of a white one, with noise of its own, in linear light.

    Args:
        scene: Whose sensor it is.
        light: Its views; the picture is of their shape.
    """
    recorded = chain.recorded(torch.full_like(light.views, WHITE), scene.sensor, scene.seed + 1)
    return LightField(scene.sensor.encoding.decode(recorded))
