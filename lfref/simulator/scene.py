"""A scene in plain numbers: what there is, how it is lit, and what looks at it. Nothing is painted here.

Coordinates are pixels of the central view from the picture's centre, x to the right and y down; aperture points (p, q)
are view steps from the angular centre. Larger disparity is nearer, and hides what is behind.
"""

from dataclasses import dataclass, field

from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.simulator import checks
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.materials import Material, Matte
from lfref.simulator.mattes import Full, Outline
from lfref.simulator.surfaces import STEEPEST, Geometry
from lfref.simulator.textures import Texture

APERTURES = ("square", "disc")


@dataclass(frozen=True)
class Camera:
    """The views, and the lens whose aperture they sample."""

    grid: tuple[int, int] = (7, 7)
    """View rows and columns (V, U)."""
    size: tuple[int, int] = (256, 256)
    """Height and width (H, W) of a view in pixels."""
    aperture: str = "square"
    """`square` or `disc`; it spans the cells of all views, U by V view steps."""
    samples: int = field(default=1, repr=False)  # versions of sim30 are hashes of what cameras say of themselves
    """Along each axis of a pixel, which is their mean: textures end at samples / 2 cycles a pixel, so that more than
    one sample leaves detail that aliases in the views."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        for what, values in (("a camera's grid", self.grid), ("a camera's size", self.size)):
            checks.pair(what, values, least=1)
            if not all(isinstance(value, int) for value in values):
                raise InputError(f"{what} must be whole numbers", got=values)
        if not (isinstance(self.samples, int) and 1 <= self.samples <= 8):
            raise InputError("a camera's samples must be a whole number from 1 to 8", got=repr(self.samples))
        if self.aperture not in APERTURES:
            raise InputError(f"aperture must be one of {', '.join(APERTURES)}", got=repr(self.aperture))

    @property
    def half_aperture(self) -> tuple[float, float]:
        """Distance of the aperture's edge from its centre along p and along q, in view steps."""
        return self.grid[1] / 2, self.grid[0] / 2

    def pixels(self) -> tuple[Tensor, Tensor]:
        """Positions x [1, 1, W] and y [1, H, 1] of the pixels, from the picture's centre, float64."""
        y, x = (geometry.angular_offsets(length) for length in self.size)
        return x[None, None], y[None, :, None]


@dataclass(frozen=True)
class Surface:
    """One thing to be seen."""

    geometry: Geometry
    """Where it stands."""
    texture: Texture
    """Its colours."""
    matte: Outline = Full()  # noqa: RUF009  frozen
    """Its outline."""
    material: Material = Matte()  # noqa: RUF009  frozen
    """What it does with light."""
    opacity: float = 1.0
    """Share of what is behind that it hides, within its outline, from 0 to 1."""
    motion: tuple[float, float] = (0.0, 0.0)
    """(x, y) in pixels that it moves during the exposure, half of it before the middle."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        for what, value, wanted in (
            ("a surface's geometry", self.geometry, Geometry),
            ("a surface's texture", self.texture, Texture),
            ("a surface's matte", self.matte, Outline),
            ("a surface's material", self.material, Material),
        ):
            checks.kind(what, value, wanted)
        checks.numbers("a surface's opacity", [self.opacity], 0, 1)
        checks.pair("a surface's motion", self.motion)


@dataclass(frozen=True)
class Light:
    """What falls on all surfaces."""

    gain: float = 1.0
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Red, green and blue."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.numbers("a light's gain", [self.gain], least=0)
        checks.colour("a light's colour", self.colour, most=1e6)


@dataclass(frozen=True)
class Scene:
    """All that a picture depends on."""

    camera: Camera
    surfaces: tuple[Surface, ...]
    """In any order: disparity decides what hides what."""
    light: Light = Light()
    sensor: Sensor = Sensor()  # noqa: RUF009  frozen
    name: str = ""
    seed: int = 0
    """Of random textures, each together with its surface's place in the list."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        for what, value, wanted in (
            ("a scene's camera", self.camera, Camera),
            ("a scene's light", self.light, Light),
            ("a scene's sensor", self.sensor, Sensor),
        ):
            checks.kind(what, value, wanted)
        if not isinstance(self.surfaces, tuple) or not self.surfaces:
            raise InputError("a scene needs at least one surface", got=self.surfaces)
        checks.numbers("a scene's seed", [self.seed], least=0)
        for surface in self.surfaces:
            checks.kind("a scene's surfaces", surface, Surface)
            self._check_steepness(surface)

    def _check_steepness(self, surface: Surface) -> None:
        half = self.camera.half_aperture
        change = sum(slope * way for slope, way in zip(surface.geometry.steepness(), half, strict=True))
        if change > STEEPEST:
            raise InputError(
                f"disparity may change by {STEEPEST:g} / (half the views) a pixel at most",
                got=f"{change:.3g} a pixel times half the views, {surface.geometry}",
                remedy="use a flatter surface or fewer views",
            )
