"""Simulating a scene: the passes that the results asked for depend on, planned so that only those run that matter.

Letters: `V U` view rows and columns, `N` planes.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import FocalPlanes, Slopes
from lfref.simulator import bitmaps, planner, render, truth
from lfref.simulator.bitmaps import Layer
from lfref.simulator.effects import chain
from lfref.simulator.planner import Pass, Row
from lfref.simulator.scene import Camera, Scene

PAPER = FocalPlanes(tuple(step / 8 for step in range(1, 17)))
"""The planes of the paper's stacks."""
OUTPUTS = ("views", "truth", "disparity")
SEEN = 0.5  # opacity from which a surface is what a pixel shows


@dataclasses.dataclass(frozen=True, eq=False)
class Simulated:
    """What was asked for of a scene; the rest is None."""

    slopes: Tensor
    """Of the truth's planes, in pixels per view step, float64, [N]."""
    rows: tuple[Row, ...]
    """What became of every pass."""
    views: Tensor | None = None
    """What the sensor hands over, float32, [V, U, 3, H, W]."""
    truth: Tensor | None = None
    """What a lens with the whole aperture records, linear and without the sensor's effects, float32, [N, 3, H, W]."""
    disparity: Tensor | None = None
    """Of what the central view shows, in pixels per view step, float32, [H, W]."""


def simulate(
    scene: Scene,
    seed: int = 0,
    outputs: Sequence[str] = ("views", "truth"),
    slopes: Slopes | None = None,
    force: bool = False,
    device: str | torch.device = "cpu",
) -> Simulated:
    """Simulate a scene.

    Args:
        scene: The scene.
        seed: Added to the scene's own: other textures and noise of the same kind.
        outputs: Any of `views`, `truth`, `disparity`.
        slopes: Planes of the truth, in pixels per view step, [N]; None takes the paper's 16.
        force: Run passes that change nothing too, which gives the same results later.
        device: Where it is rendered.

    Returns:
        The results, and what became of each pass.

    Raises:
        InputError: An output that does not exist, or slopes that the views are too small for.
    """
    if not outputs or not set(outputs) <= set(OUTPUTS):
        raise InputError(f"outputs must be some of {', '.join(OUTPUTS)}", got=list(outputs))
    seeded = dataclasses.replace(scene, seed=scene.seed + seed)
    camera = scene.camera
    planes = geometry.checked_slopes(PAPER.slopes if slopes is None else slopes, camera.grid, camera.size)
    plan = planner.plan(passes(seeded, planes, device), list(outputs), seeded, force)
    results: dict[str, Any] = plan.run()
    return Simulated(planes, tuple(plan.explain()), **results)


def passes(scene: Scene, slopes: Tensor, device: str | torch.device = "cpu") -> list[Pass]:
    """All passes, whatever is asked for.

    Args:
        scene: The scene.
        slopes: Planes of the truth, [N].
        device: Where it is rendered.
    """
    reach, camera = float(slopes.abs().max()), scene.camera
    return [
        Pass("paint", (), "layers", functools.partial(bitmaps.paint, scene, device, reach)),
        Pass("view", ("layers",), "radiance", functools.partial(render.views, camera=camera)),
        *chain.sensor_passes(scene),
        Pass("photograph", ("layers",), "truth", functools.partial(truth.stack, camera=camera, slopes=slopes)),
        Pass("find disparity", ("layers",), "disparity", functools.partial(central_disparity, camera=camera)),
    ]


def central_disparity(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Disparity of the nearest surface that each pixel of the central view shows, float32, [H, W].

    Args:
        layers: From far to near.
        camera: What looks at them.
    """
    centre = torch.zeros(1, dtype=torch.float64)
    x, y = camera.pixels()
    shape = (1, *camera.size)
    found = torch.full(shape, -torch.inf, dtype=torch.float64)
    for layer in layers:
        met = layer.surface.geometry.met_at(x, y, centre[:, None, None], centre[:, None, None]).expand(shape)
        seen = layer.seen(centre, centre, x, y)[:, 3].cpu() > SEEN
        found = torch.where(seen, torch.maximum(found, met), found)
    return torch.where(found.isfinite(), found, 0.0)[0].float()
