"""A scene in plain numbers: surfaces, light and camera. Nothing is painted here.

Coordinates are pixels of the central view from the picture's centre, x to the right and y down; aperture points (p, q)
are view steps from the angular centre. The surface of larger disparity is nearer and hides other surfaces.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.simulator import checks
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.materials import Material, Matte
from lfref.simulator.mattes import Full, Outline
from lfref.simulator.surfaces import STEEPEST, Geometry
from lfref.simulator.textures import Texture

Count = Annotated[int, 1, math.inf]


@dataclass(frozen=True)
class Camera(checks.Description):
    """A grid of views, and the lens whose aperture they sample."""

    grid: tuple[Count, Count] = (7, 7)  # view rows and columns (V, U)
    size: tuple[Count, Count] = (256, 256)  # height and width (H, W) of a view in pixels
    aperture: str = "square"  # `square` or `disc`, U by V view steps: the cells of all views
    samples: Annotated[int, 1, 8] = field(default=1, repr=False)  # keeps the repr of older descriptions
    """Samples along each axis of a pixel; a pixel is the mean of its samples. Textures end at samples / 2 cycles per
    pixel: with more than one sample, details alias in the views."""
    truth_error: checks.Positive = field(default=1e-4, repr=False)
    """Greatest root mean square error of a truth near focus, of light 1; planes of a wide blur are more exact.
    With .001 a truth takes a third of the time of .0001."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.aperture not in ("square", "disc"):
            raise InputError("aperture must be one of square, disc", got=repr(self.aperture))

    @property
    def half_aperture(self) -> tuple[float, float]:
        """Greatest |p| and |q| of aperture points, in view steps."""
        return self.grid[1] / 2, self.grid[0] / 2

    def pixels(self) -> tuple[Tensor, Tensor]:
        """Positions x [1, 1, W] and y [1, H, 1] of the pixels, from the picture's centre, float64."""
        y, x = (geometry.angular_offsets(length) for length in self.size)
        return x[None, None], y[None, :, None]


@dataclass(frozen=True)
class Surface(checks.Description):
    """A surface: shape, outline and looks."""

    lengths = ("motion",)
    geometry: Geometry
    texture: Texture
    matte: Outline = Full()  # noqa: RUF009  frozen
    material: Material = Matte()  # noqa: RUF009  frozen
    opacity: checks.Share = 1.0  # share of the background that it hides within its outline
    motion: tuple[float, float] = (0.0, 0.0)
    """Movement (x, y) in pixels during the exposure; geometry and outline describe the middle of the exposure."""


@dataclass(frozen=True)
class Light(checks.Description):
    """The light that falls on all surfaces."""

    gain: checks.NotNegative = 1.0
    colour: tuple[checks.NotNegative, checks.NotNegative, checks.NotNegative] = (1.0, 1.0, 1.0)  # red, green and blue


@dataclass(frozen=True)
class Scene(checks.Description):
    """Everything that a picture depends on."""

    camera: Camera
    surfaces: tuple[Surface, ...]  # surfaces in any order: disparity decides which surface hides another
    light: Light = Light()
    sensor: Sensor = Sensor()  # noqa: RUF009  frozen
    name: str = ""
    seed: checks.Seed = 0  # seed of noise and random textures; the index of a surface also enters its texture

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.surfaces:
            raise InputError("a scene needs at least one surface")
        half = self.camera.half_aperture
        for surface in self.surfaces:
            change = sum(slope * side for slope, side in zip(surface.geometry.steepness(), half, strict=True))
            if change > STEEPEST:
                expected = f"disparity may change by {STEEPEST:g} / (half the views) a pixel at most"
                got, remedy = f"{change:.3g} of {surface.geometry}", "use a flatter surface or fewer views"
                raise InputError(expected, got=got, remedy=remedy)
