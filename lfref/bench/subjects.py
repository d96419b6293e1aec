"""What methods are judged on: light fields, each with the stack that a perfect method would make of it.

A simulated scene has the picture of a lens. A capture of many views has its dense integral, which every second or third
of its views should come near to. Other light fields have exact Fourier refocusing of their own views, which judges how
an operator forms the sum, and not how good the picture is.
Letters: `V U` view rows and columns, `N` planes.
"""

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Aperture, Refocuser
from lfref.simulator.developed import developed
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import simulate

IDEAL, SENSOR, GIVEN = "ideal", "sensor", "given"
"""Classes: scenes without and with a sensor's effects, light fields without a truth."""
TRUTH, EXACT = "truth", "exact_fourier"
"""References."""
APERTURES: dict[str, Aperture | None] = {"square": None, "disc": apertures.disc}
"""Weights of the views by the shape of a camera's aperture. A square is the mean of all cells; of a disc, the cells
count that it covers, and those that its edge crosses by their share."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A light field and the stack that it is judged by."""

    kind: str
    """The class that it is summarised in, such as `ideal`."""
    light: LightField
    truth: Tensor
    """Stack, [N, C, H, W]."""
    reference: str
    """What the truth is."""
    aperture: Aperture | None = None
    """Weights of the views through which the truth was taken; None: all alike."""
    sensor: Sensor = Sensor()  # noqa: RUF009  frozen
    """Whose tone curve views and truth have."""

    def stack(self, method: Refocuser, slopes: Tensor) -> Tensor:
        """What a method makes of the light field, through the aperture that the truth was taken through.

        Args:
            method: Operators get the aperture; networks have none, and are judged as they are.
            slopes: Of the truth's planes, in pixels per view step, [N].
        """
        return method.through(self.aperture)(self.light, slopes)


def simulated(scenes: Iterable[Scene], slopes: Tensor, device: torch.device) -> Iterator[Subject]:
    """Scenes with their truth: each without its sensor, and those that have one also with it.

    With a sensor, the truth is developed as the views are: exposure, clipping, colours and tone curve are no fault of
    refocusing.

    Args:
        scenes: Of any grid and size.
        slopes: In pixels per view step, [N].
        device: Where they are rendered.
    """
    for scene in scenes:
        aperture = APERTURES[scene.camera.aperture]
        clean = simulate(dataclasses.replace(scene, sensor=Sensor()), slopes=slopes, device=device)
        assert clean.views is not None
        assert clean.truth is not None
        yield Subject(IDEAL, LightField(clean.views, scene.name), clean.truth, TRUTH, aperture)
        if scene.sensor != Sensor():
            yield _with_sensor(scene, clean.truth, aperture, device)


def _with_sensor(scene: Scene, truth: Tensor, aperture: Aperture | None, device: torch.device) -> Subject:
    views = simulate(scene, outputs=("views",), slopes=[0.0], device=device).views
    assert views is not None
    light = LightField(views, scene.name)
    return Subject(SENSOR, light, developed(truth, scene.sensor), TRUTH, aperture, scene.sensor)


def given(fields: Iterable[LightField], slopes: Tensor) -> Iterator[Subject]:
    """Light fields of which nothing but the views is known.

    Args:
        fields: On the device where they are refocused.
        slopes: In pixels per view step, [N].
    """
    exact = OperatorRefocuser(EXACT, exact_fourier)
    for field in fields:
        yield Subject(GIVEN, field, exact(field, slopes), EXACT)
