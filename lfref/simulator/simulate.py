"""Simulating a scene: the planner runs the passes that the requested outputs depend on and that change something.

    scene -> painted layers -> views -> sensor's effects in the order of light
                            -> truth of a lens with the whole aperture
                            -> disparity, picture and masks of the central view

A truth is linear and has no effects of a sensor. Before it is compared with views, or a network learns from it,
`developed` applies the effects that treat all samples alike (`SHARED_EFFECTS`). Defects of the views (noise, mosaic,
quantisation, vignetting, crosstalk, aberrations, misalignment) stay with the views.
Letters: `V U` view rows and columns, `N` planes, `K` surfaces.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Generator, Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import Slopes
from lfref.lightfield import LightField
from lfref.simulator import painting, planner, truth, views
from lfref.simulator.effects.sensor import Sensor, effect_chain, recorded, sensor_passes
from lfref.simulator.layers import Layer
from lfref.simulator.planner import Outcome, Pass
from lfref.simulator.scene import Scene

PAPER = geometry.planes_at_alphas(step / 8 for step in range(1, 17))
OUTPUTS = ("views", "truth", "disparity", "all_in_focus", "masks")
SHARED_EFFECTS = ("exposure", "clipping", "white_balance", "tone_curve")
"""Effects that treat all samples of a colour alike; `developed` applies them to a truth."""


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """The requested outputs of a scene; other outputs are None."""

    slopes: Tensor
    """Slopes of the truth's planes, in pixels per view step, float64, [N]."""
    rows: tuple[Outcome, ...]
    views: Tensor | None = None
    """Views as the sensor records them, float32, [V, U, 3, H, W]."""
    truth: Tensor | None = None
    """Stack of a lens with the whole aperture, linear and without the sensor's effects, float32, [N, 3, H, W]."""
    disparity: Tensor | None = None
    """Disparity of the nearest surface in the central view, in pixels per view step, float32, [H, W]."""
    all_in_focus: Tensor | None = None
    """The central view through a pinhole, linear and without the sensor's effects, float32, [3, H, W]."""
    masks: Tensor | None = None
    """Share of each surface of the scene in each pixel of the central view, float32, [K, H, W]."""


class Simulation:
    """A scene that is painted once for several calls, and again if a truth reaches beyond slopes of `reach`."""

    def __init__(self, scene: Scene, reach: float = 0.0, force: bool = False) -> None:
        self.scene, self.reach, self.force = scene, reach, force
        # A camera with several samples per pixel is rendered with pixels as small as its samples.
        self._fine_scene = finer(scene, scene.camera.samples)
        self._layers: list[Layer] | None = None

    def run(self, outputs: Sequence[str] = ("views", "truth"), slopes: Slopes | None = None) -> Simulated:
        """The requested outputs; arguments, result and errors as for `simulate`."""
        if not outputs or not set(outputs) <= set(OUTPUTS):
            raise InputError(f"outputs must be some of {', '.join(OUTPUTS)}", got=list(outputs))
        camera = self.scene.camera
        planes = geometry.as_slopes(PAPER.slopes if slopes is None else slopes)
        if "truth" in outputs:  # no other output depends on the planes
            planes = geometry.checked_slopes(planes, camera.grid, camera.size)
        if "truth" in outputs and float(planes.abs().max()) > self.reach:
            self.reach, self._layers = float(planes.abs().max()), None
        results, rows = planner.run(self._passes(planes), [*outputs, "layers"], self.force)
        self._layers = results.pop("layers")
        return Simulated(planes, rows, **results)

    def _passes(self, planes: Tensor) -> list[Pass]:
        """All passes, whatever the outputs."""
        scene, camera, n_samples = self.scene, self._fine_scene.camera, self.scene.camera.samples

        def render(name: str, makes: str, function: Callable[..., Tensor], *options: Any) -> Pass:
            def run(layers: list[Layer]) -> Tensor:
                result = function(layers, camera, *options)
                if n_samples > 1 and makes == "disparity":
                    return F.max_pool2d(result[None], n_samples)[0] / n_samples  # the nearest, in larger pixels
                return result if n_samples == 1 else averaged(result, n_samples)

            return Pass(name, ("layers",), makes, run)

        if self._layers is None:
            passes = painting.passes(self._fine_scene, n_samples * self.reach, self.force)
        else:
            passes = [Pass("take what is painted", (), "layers", lambda: self._layers)]
        return [
            *passes,
            render("view", "radiance", views.views),
            render("photograph", "truth", truth.stack, n_samples * planes, n_samples),
            render("look through a pinhole", "all_in_focus", views.all_in_focus),
            render("find disparity", "disparity", views.disparity),
            render("find masks", "masks", views.masks, len(scene.surfaces)),
            *sensor_passes(scene.sensor, scene.seed),
        ]


def simulate(
    scene: Scene,
    seed: int = 0,
    outputs: Sequence[str] = ("views", "truth"),
    slopes: Slopes | None = None,
    force: bool = False,
) -> Simulated:
    """Simulate a scene; the result has the outputs, and an explanation of each pass.

    Args:
        scene: The scene.
        seed: Number that is added to the seed of the scene: another number gives other textures and noise.
        outputs: Any of `views`, `truth`, `disparity`, `all_in_focus`, `masks`.
        slopes: Planes of the truth, in pixels per view step, [N]; None takes the paper's 16.
        force: Run inert passes too, and each pass on every surface: the results are the same and take longer.

    Raises:
        InputError: An unknown output, or slopes that are too large for the views.

    Example:
        >>> from lfref.simulator import sim30
        >>> result = lfref.simulate(sim30.SCENES["plane"], outputs=["views", "truth"], slopes=[-0.5, 0])
        >>> result.views.shape[:3], result.truth.shape[:2]
        (torch.Size([7, 7, 3]), torch.Size([2, 3]))
    """
    seeded = dataclasses.replace(scene, seed=scene.seed + seed)
    return Simulation(seeded, force=force).run(outputs, slopes)


def finer(scene: Scene, factor: int) -> Scene:
    """This scene for a camera whose pixels are `factor` times smaller; `factor` divides its `samples`.

    Lengths and disparities are in pixels, so that they are multiplied, as slopes are; random textures are drawn anew.
    The mean over `factor` by `factor` pixels of a finer picture is a pixel of a picture of `scene`.
    """
    if factor == 1:
        return scene
    height, width = (factor * length for length in scene.camera.size)
    camera = dataclasses.replace(scene.camera, size=(height, width), samples=scene.camera.samples // factor)
    surfaces = tuple(_enlarged(surface, factor) for surface in scene.surfaces)
    return dataclasses.replace(scene, camera=camera, surfaces=surfaces)


def _enlarged(part: Any, factor: int) -> Any:
    """A part of a scene whose `lengths`, and those of its own parts, are multiplied."""

    def multiplied(lengths: Any) -> Any:
        return tuple(map(multiplied, lengths)) if isinstance(lengths, tuple) else factor * lengths

    changes: dict[str, Any] = {}
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if field.name in part.lengths:
            changes[field.name] = multiplied(value)
        elif hasattr(value, "lengths"):
            changes[field.name] = _enlarged(value, factor)
    return dataclasses.replace(part, **changes)


def averaged(pictures: Tensor, factor: int) -> Tensor:
    """Means of pictures [..., H, W] over squares of `factor` x `factor` pixels."""
    flat = pictures.reshape(-1, *pictures.shape[-2:])
    return F.avg_pool2d(flat, factor).unflatten(0, pictures.shape[:-2])


def developed(pictures: Tensor, sensor: Sensor) -> Tensor:
    """Linear pictures [..., 3, H, W] as a sensor would have recorded them without its defects, clipped if it clips."""
    for name, effect in effect_chain(sensor).items():
        if name in SHARED_EFFECTS:
            pictures = effect.apply(pictures, Generator())  # none of these draws random numbers
    return pictures


def white_picture(scene: Scene, light: LightField) -> LightField:
    """The picture of a white scene, of the shape of `light`, by which the scene's camera is calibrated, linear."""
    # White of radiance 0.8: below 1, so that noise is not clipped.
    views = recorded(torch.full_like(light.views, 0.8), scene.sensor, scene.seed + 1)
    return LightField(scene.sensor.encoding.decode(views))
