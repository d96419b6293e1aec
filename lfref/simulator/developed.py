"""What a camera's files would hold of a picture that its lens records: in the brightness and colours of its views.

A truth is linear and knows no sensor. To be compared with views, or learned from them, it takes on what the sensor and
its software do to every sample alike. Defects of the views (noise, mosaic, quantisation, vignetting, crosstalk,
aberrations, misalignment) stay with the views.
"""

import torch
from torch import Generator, Tensor

from lfref.lightfield import LightField
from lfref.simulator.effects import chain
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Scene

SHARED = ("exposure", "clipping", "white_balance", "tone_curve")
"""Fields of `Sensor` that are the same for every sample of a colour."""


def developed(pictures: Tensor, sensor: Sensor) -> Tensor:
    """Pictures as a sensor would have recorded them, without its defects.

    Args:
        pictures: Linear radiance, [..., 3, H, W].
        sensor: The scene's.

    Returns:
        Pictures of the same shape; where the sensor clips, so are they.
    """
    for effect in chain.effects(sensor):
        if effect.name in SHARED:
            # None of these draws anything.
            pictures = effect.apply(pictures, Generator())
    return pictures


# PART white_picture
# The picture of a white scene by which a camera is calibrated: it shows the vignetting of every view.

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
