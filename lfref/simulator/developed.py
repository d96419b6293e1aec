"""Pictures of a lens as the files of a camera would hold them: in the brightness and colours of its views.

A truth is linear and has none of a sensor's effects. To be compared with views, or learned from them, it takes on what
sensor and software do to every sample alike. Defects of the views (noise, mosaic, quantisation, vignetting, crosstalk,
aberrations, misalignment) stay with the views. Beside the truth, data sets and benchmarks also need the white picture
that a camera is calibrated by.
"""

import torch
from torch import Generator, Tensor

from lfref.lightfield import LightField
from lfref.simulator.effects.sensor import Sensor, effect_chain, recorded
from lfref.simulator.scene import Scene

SHARED = ("exposure", "clipping", "white_balance", "tone_curve")
"""Effects that treat all samples of a colour alike."""
WHITE = 0.8
"""Radiance of the white scene: below 1, so that noise is not clipped."""


def developed(pictures: Tensor, sensor: Sensor) -> Tensor:
    """Pictures as a sensor would have recorded them, without its defects.

    Args:
        pictures: Linear radiance, [..., 3, H, W].
        sensor: The scene's.

    Returns:
        Pictures of the same shape, clipped if the sensor clips.
    """
    for name, effect in effect_chain(sensor).items():
        if name in SHARED:
            pictures = effect.apply(pictures, Generator())  # none of these draws random numbers
    return pictures


def white_picture(scene: Scene, light: LightField) -> LightField:
    """The picture of a white scene, which shows the vignetting of every view, with noise of its own, in linear light.

    Args:
        scene: The scene whose sensor records it.
        light: Views of the scene; the picture has their shape.
    """
    views = recorded(torch.full_like(light.views, WHITE), scene.sensor, scene.seed + 1)
    return LightField(scene.sensor.encoding.decode(views))
