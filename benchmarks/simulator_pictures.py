"""Draw what a lens records: the truth beside sums of views, how its aperture is sampled, and the scenes of sim30.

Pictures and text of `simulator.md`. Letters: `s` slope in pixels per view step.
"""

from collections.abc import Callable, Iterator
from typing import Any

import sheets
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from torch import Tensor

import lfref
from lfref.simulator import planner, sim30
from lfref.simulator.effects.noise import Noise as SensorNoise
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.mattes import Leaf, Twigs
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Noise

CAMERA = Camera(size=(96, 144))
FAR, NEAR, BETWEEN = -3.0, 1.8, 0.6  # the wall's disparity, the leaf's and twigs', and a slope that suits neither
WALL = Surface(Plane(FAR), Checker(48.0, (0.35, 0.25, 0.2), (0.8, 0.75, 0.65), angle=8))
MOSS = Noise((0.15, 0.3, 0.1), (0.1, 0.2, 0.1), hardness=0.5)
GARDEN = (
    WALL,
    Surface(Plane(NEAR), MOSS, Leaf(90, 36, -35, (-28, 0))),
    Surface(Plane(NEAR), MOSS, Twigs(30, 2, 4, foot=(40, 46), seed=8)),
)
FINEST = 64  # cells a side that stand for the whole aperture
DIFFERENCE: dict[str, Any] = {"cmap": "magma", "norm": LogNorm(1e-4, 0.1)}


def beside_views() -> Figure:
    """The truth at two slopes, the same from 49 views, and what these lack."""
    result = lfref.simulate(Scene(CAMERA, GARDEN), slopes=(FAR, NEAR))
    summed = lfref.shift_and_sum(result.views, result.slopes)
    cells = []
    for slope, lens, views in zip(result.slopes.tolist(), result.truth, summed, strict=True):
        cells += [(f"truth, {sheets.at(slope)}", lens), ("shift_and_sum of 49 views", views)]
        cells.append(difference(views, lens))
    return sheets.sheet(cells, bar="absolute difference", **DIFFERENCE)


def thirty() -> Figure:
    """The middle view of every scene of sim30."""
    return sheets.sheet(
        [(name, lfref.simulate(scene, outputs=("views",)).views[3, 3]) for name, scene in sim30.SCENES.items()], 10
    )


def explanation() -> Iterator[str]:
    """The passes that ran for views and truth of a scene, as a block of text."""
    noisy = Scene(CAMERA, GARDEN, sensor=Sensor(noise=SensorNoise(1e-3)))
    # The first call compiles.
    _, timed = (lfref.simulate(noisy, slopes=(FAR, NEAR), timed=True) for _ in range(2))
    yield "```"
    yield planner.table(timed.rows)
    yield "```"


PICTURES: dict[str, Callable[[], Figure]] = {
    "simulator_truth.jpg": beside_views,
    "simulator_sim30.jpg": thirty,
}


def difference(image: Tensor, reference: Tensor) -> tuple[str, Tensor]:
    """A cell with the absolute difference of two pictures, its PSNR above it."""
    return f"difference, {sheets.decibels(image, reference)}", (image - reference).abs().mean(0).clamp(
        min=DIFFERENCE["norm"].vmin
    )
