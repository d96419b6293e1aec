"""What methods are judged on: light fields, each with the stack that a perfect method would make of it.

A simulated scene has the picture of a lens. A capture of many views has its dense integral, which every second or third
of its views should come near to. Other light fields have exact Fourier refocusing of their own views, which judges how
an operator forms the sum, and not how good the picture is. Views are decoded to linear light as a reader would, and
pictures are compared as a screen gets them: encoded by the same curve.
Letters: `V U` view rows and columns, `N` planes.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from lfref.bench.quality import Shown
from lfref.captures.correct import AUTO, as_asked
from lfref.encoding import LINEAR, Encoding
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Aperture, Refocuser
from lfref.simulator.developed import developed, white_picture
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import simulate

IDEAL, SENSOR, CORRECTED, GIVEN = "ideal", "sensor", "corrected", "given"
"""Classes: scenes without and with a sensor's effects, the latter put right, light fields without a truth."""
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
    """Stack, [N, C, H, W], in linear light where the views are."""
    reference: str
    """What the truth is."""
    aperture: Aperture | None = None
    """Weights of the views through which the truth was taken; None: all alike."""
    encoding: Encoding = LINEAR
    """How pictures are shown; views that are not linear have it already."""

    def stack(self, method: Refocuser, slopes: Tensor) -> Tensor:
        """What a method makes of the light field, through the aperture that the truth was taken through.

        Args:
            method: Operators get the aperture; networks have none, and are judged as they are.
            slopes: Of the truth's planes, in pixels per view step, [N].
        """
        return method.through(self.aperture)(self.light, slopes)

    def shown(self, stack: Tensor) -> Shown:
        """A stack as it is looked at.

        Args:
            stack: Of these views, or the truth, [N, C, H, W].
        """
        stack = stack.cpu()
        if self.light.is_linear:
            return Shown(self.encoding.encode(stack), stack)
        return Shown(stack, self.encoding.decode(stack))


EVEN = "methods are compared on an even grid"


def put_right(scene: Scene, light: LightField) -> LightField:
    """The views of a scene, corrected by what they show.

    Args:
        scene: Not looked at.
        light: Its views.
    """
    return as_asked(light, AUTO, even=EVEN)[0]


def put_right_by_white(scene: Scene, light: LightField) -> LightField:
    """The views of a scene, corrected by what they show and by a picture of a white scene.

    Args:
        scene: Whose sensor photographs it, with noise of its own.
        light: Its views.
    """
    return as_asked(light, AUTO, white_picture(scene, light), EVEN)[0]


CORRECTIONS: dict[str, Callable[[Scene, LightField], LightField] | None] = {
    "none": None,
    "auto": put_right,
    "white": put_right_by_white,
}
"""What may be done to views before they are refocused, by name."""


def simulated(
    scenes: Iterable[Scene], slopes: Tensor, device: torch.device, correction: str = "none"
) -> Iterator[Subject]:
    """Scenes with their truth: each without its sensor, those that have one also with it, as it is and put right.

    With a sensor, the truth is developed as the views are: exposure, clipping, colours and tone curve are no fault of
    refocusing.

    Args:
        scenes: Of any grid and size.
        slopes: In pixels per view step, [N].
        device: Where they are rendered.
        correction: A key of `CORRECTIONS`.
    """
    for scene in scenes:
        aperture = APERTURES[scene.camera.aperture]
        clean = simulate(dataclasses.replace(scene, sensor=Sensor()), slopes=slopes, device=device)
        assert clean.views is not None
        assert clean.truth is not None
        yield Subject(IDEAL, LightField(clean.views, scene.name), clean.truth, TRUTH, aperture)
        if scene.sensor != Sensor():
            yield (found := _with_sensor(scene, clean.truth, aperture, device))
            if (mended := CORRECTIONS[correction]) is not None:
                yield dataclasses.replace(found, kind=CORRECTED, light=mended(scene, found.light))


def _with_sensor(scene: Scene, truth: Tensor, aperture: Aperture | None, device: torch.device) -> Subject:
    views = simulate(scene, outputs=("views",), slopes=[0.0], device=device).views
    assert views is not None
    encoding = scene.sensor.encoding
    light = LightField(encoding.decode(views), scene.name)
    return Subject(SENSOR, light, encoding.decode(developed(truth, scene.sensor)), TRUTH, aperture, encoding)


def given(fields: Iterable[LightField], slopes: Tensor) -> Iterator[Subject]:
    """Light fields of which nothing but the views is known.

    Args:
        fields: On the device where they are refocused.
        slopes: In pixels per view step, [N].
    """
    exact = OperatorRefocuser(EXACT, exact_fourier)
    for field in fields:
        yield Subject(GIVEN, field, exact(field, slopes), EXACT)
