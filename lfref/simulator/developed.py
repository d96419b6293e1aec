"""What a camera's files would hold of a picture that its lens records: in the brightness and colours of its views.

A truth is linear and knows no sensor. To be compared with views, or learned from them, it takes on what the sensor and
its software do to every sample alike. Defects of the views (noise, mosaic, quantisation, vignetting, crosstalk,
aberrations, misalignment) stay with the views.
"""

from torch import Generator, Tensor

from lfref.simulator.effects import chain
from lfref.simulator.effects.sensor import Sensor

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
