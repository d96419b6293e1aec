"""Simulating a scene: the passes that the results asked for depend on, planned so that only those run that matter.

Letters: `V U` view rows and columns, `N` planes, `K` surfaces.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import Slopes
from lfref.simulator import bitmaps, materials, mattes, planner, surfaces, textures, truth, views
from lfref.simulator.effects import chain
from lfref.simulator.layers import Layer
from lfref.simulator.planner import Outcome, Pass
from lfref.simulator.scene import Scene, Surface

# PART finer
# The same scene for smaller pixels: what a camera's pixels average over, and the truth on a finer grid.
#
# Lengths and disparities are in pixels, so that they grow as pixels shrink; random textures are drawn anew, down to the
# smaller pixels. Averages over what was one pixel are what the coarser camera records.

LENGTHS: dict[type, tuple[str, ...]] = {
    surfaces.Plane: ("disparity",),
    surfaces.Dome: ("disparity", "bulge", "radius", "centre"),
    mattes.Full: (),
    mattes.Disc: ("radius", "centre"),
    mattes.Polygon: ("corners",),
    mattes.Leaf: ("length", "width", "centre"),
    mattes.Twigs: ("length", "width", "foot"),
    mattes.Perforated: ("pitch", "radius"),
    materials.Matte: (),
    materials.Emissive: (),
    materials.Glossy: ("width", "drift", "centre"),
    materials.Mirror: ("disparity",),
    materials.Glass: ("disparity",),
    textures.Flat: (),
    textures.Gradient: ("period",),
    textures.Stripes: ("period",),
    textures.Checker: ("period",),
    textures.Noise: (),
    textures.Picture: ("width",),
    Surface: ("motion",),
}
"""Fields in pixels, or in pixels per view step, of every part of a scene."""


def finer(scene: Scene, factor: int) -> Scene:
    """The scene as a camera sees it whose pixels are `factor` times smaller along each axis.

    Args:
        scene: The scene.
        factor: Of which its camera's `samples` are a multiple. Pictures of the two scenes then agree: the mean over
            `factor` by `factor` pixels of one is a pixel of the other, where slopes are `factor` times larger.

    Raises:
        InputError: The camera takes other samples.

    Example:
        >>> from lfref.simulator import sim30
        >>> finer(sim30.scenes("plane", version=2).scenes[0], 2).camera.size
        (256, 384)
    """
    if factor == 1:
        return scene
    camera = scene.camera
    if factor < 1 or camera.samples % factor:
        remedy = "give the camera more samples"
        raise InputError(f"a camera's samples must be a multiple of {factor}", got=camera.samples, remedy=remedy)
    height, width = (factor * length for length in camera.size)
    camera = dataclasses.replace(camera, size=(height, width), samples=camera.samples // factor)
    return dataclasses.replace(
        scene, camera=camera, surfaces=tuple(_enlarged(surface, factor) for surface in scene.surfaces)
    )


def nearest(disparity: Tensor, factor: int) -> Tensor:
    """The greatest disparity in squares of `factor` by `factor` pixels, per view step of a square's side.

    Args:
        disparity: Height and width are multiples of the factor, [H, W].
        factor: Side of a square.
    """
    return F.max_pool2d(disparity[None], factor)[0] / factor


def averaged(pictures: Tensor, factor: int) -> Tensor:
    """Means over squares of `factor` by `factor` pixels.

    Args:
        pictures: Height and width are multiples of the factor, [..., H, W].
        factor: Side of a square.
    """
    flat = pictures.reshape(1, -1, *pictures.shape[-2:])
    means = F.avg_pool2d(flat, factor)
    return means.reshape(*pictures.shape[:-2], *means.shape[-2:])


def _enlarged(part: Any, factor: int) -> Any:
    """A part of a scene with all its lengths multiplied, and those of its own parts."""
    changed = {name: _times(getattr(part, name), factor) for name in LENGTHS[type(part)]}
    inner = {
        field.name: _enlarged(value, factor)
        for field in dataclasses.fields(part)
        if type(value := getattr(part, field.name)) in LENGTHS
    }
    return dataclasses.replace(part, **changed, **inner)


def _times(lengths: Any, factor: int) -> Any:
    """A length, or lengths in tuples, multiplied."""
    if isinstance(lengths, tuple):
        return tuple(_times(length, factor) for length in lengths)
    return factor * lengths


PAPER = geometry.planes_at_alphas(step / 8 for step in range(1, 17))
"""The planes of the paper's stacks."""
OUTPUTS = ("views", "truth", "disparity", "all_in_focus", "masks")
PIXELS: dict[str, Callable[[Tensor, int], Tensor]] = {"disparity": nearest}
"""What pixels make of their samples, where that is not the mean."""


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """What was asked for of a scene; the rest is None."""

    slopes: Tensor
    """Of the truth's planes, in pixels per view step, float64, [N]."""
    rows: tuple[Outcome, ...]
    """What became of every pass."""
    views: Tensor | None = None
    """What the sensor hands over, float32, [V, U, 3, H, W]."""
    truth: Tensor | None = None
    """What a lens with the whole aperture records, linear and without the sensor's effects, float32, [N, 3, H, W]."""
    disparity: Tensor | None = None
    """Of what the central view shows, in pixels per view step, float32, [H, W]."""
    all_in_focus: Tensor | None = None
    """The central view through a pinhole, linear and without the sensor's effects, float32, [3, H, W]."""
    masks: Tensor | None = None
    """Share of each surface of the scene in what the central view shows, float32, [K, H, W]."""


class Simulation:
    """A scene that is painted once for all that is asked of it.

    Args:
        scene: The scene.
        reach: Greatest |slope| that a truth will be asked for at, in pixels per view step: its surfaces are painted as
            far as that. Where a truth asks for more, they are painted again.
        force: As for `simulate`, like the device.
        device: Where it is rendered.
    """

    def __init__(
        self, scene: Scene, reach: float = 0.0, force: bool = False, device: str | torch.device = "cpu"
    ) -> None:
        self.scene, self.reach, self.force, self.device = scene, reach, force, device
        self._samples = scene.camera.samples
        self._fine = finer(scene, self._samples)
        self._layers: list[Layer] | None = None

    def run(
        self, outputs: Sequence[str] = ("views", "truth"), slopes: Slopes | None = None, timed: bool = False
    ) -> Simulated:
        """What is asked for; arguments, result and errors as for `simulate`."""
        if not outputs or not set(outputs) <= set(OUTPUTS):
            raise InputError(f"outputs must be some of {', '.join(OUTPUTS)}", got=list(outputs))
        camera = self.scene.camera
        planes = geometry.checked_slopes(PAPER.slopes if slopes is None else slopes, camera.grid, camera.size)
        if "truth" in outputs and float(planes.abs().max()) > self.reach:
            self.reach, self._layers = float(planes.abs().max()), None
        plan = planner.plan(self._passes(planes), [*outputs, "layers"], self.force)
        results = plan.run(timed)
        self._layers = results.pop("layers")
        return Simulated(planes, tuple(plan.explain()), **results)

    def _passes(self, planes: Tensor) -> list[Pass]:
        """All there are, whatever is asked for."""
        scene, slopes = self.scene, self._samples * planes
        on_layers: dict[str, tuple[str, Callable[..., Tensor]]] = {
            "view": ("radiance", views.views),
            "photograph": ("truth", functools.partial(truth.stack, slopes=slopes)),
            "look through a pinhole": ("all_in_focus", views.all_in_focus),
            "find disparity": ("disparity", views.disparity),
            "find masks": ("masks", functools.partial(views.masks, n_surfaces=len(scene.surfaces))),
        }
        return [
            *self._painting(),
            *(
                Pass(name, ("layers",), makes, functools.partial(self._seen, make, PIXELS.get(makes, averaged)))
                for name, (makes, make) in on_layers.items()
            ),
            *chain.sensor_passes(scene.sensor, scene.camera.grid, scene.seed),
        ]

    def _seen(
        self, make: Callable[..., Tensor], pixels: Callable[[Tensor, int], Tensor], layers: list[Layer]
    ) -> Tensor:
        """What the camera's samples show of layers, as pixels."""
        made = make(layers, camera=self._fine.camera)
        return made if self._samples == 1 else pixels(made, self._samples)

    def _painting(self) -> list[Pass]:
        if self._layers is not None:
            return [Pass("take what is painted", (), "layers", lambda: self._layers)]
        return bitmaps.passes(self._fine, self.device, self._samples * self.reach, self.force)


def simulate(
    scene: Scene,
    seed: int = 0,
    outputs: Sequence[str] = ("views", "truth"),
    slopes: Slopes | None = None,
    force: bool = False,
    device: str | torch.device = "cpu",
    timed: bool = False,
) -> Simulated:
    """Simulate a scene.

    Args:
        scene: The scene.
        seed: Added to the scene's own: other textures and noise of the same kind.
        outputs: Any of `views`, `truth`, `disparity`, `all_in_focus`, `masks`.
        slopes: Planes of the truth, in pixels per view step, [N]; None takes the paper's 16.
        force: Run passes that change nothing too, and each of them on every surface: all rays are followed one by
            one, met by highlights without light and mirrors that reflect nothing, and sorted by depth at each pixel;
            every effect of the sensor is applied. That gives the same results later. The aperture's cells stay as
            many; a surface alone is composited cell by cell too, instead of filtered by their sum.
        device: Where it is rendered.
        timed: Tell the milliseconds of each pass; a GPU is then waited for before and after each of them.

    Returns:
        The results, and what became of each pass.

    Raises:
        InputError: No scene, an output that does not exist, or slopes that the views are too small for.

    Example:
        >>> from lfref.simulator import sim30
        >>> made = lfref.simulate(sim30.SCENES["plane"], outputs=["views", "truth"], slopes=[-0.5, 0])
        >>> made.views.shape[:3], made.truth.shape[:2]
        (torch.Size([7, 7, 3]), torch.Size([2, 3]))
    """
    if not isinstance(scene, Scene):
        remedy = "take one of lfref.simulator.sim30.SCENES, or describe one: lfref.simulator.scene.Scene"
        raise InputError("what is simulated must be a Scene", got=repr(scene), remedy=remedy)
    seeded = dataclasses.replace(scene, seed=scene.seed + seed)
    return Simulation(seeded, force=force, device=device).run(outputs, slopes, timed)
