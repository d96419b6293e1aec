"""Compare the simulator with Mitsuba, which traces paths: the table and the picture of `simulator.md`.

Where the extra `mitsuba` is not installed there is nothing to draw, and what was measured elsewhere stays.
"""

import importlib.util
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import mitsuba_scenes
import sheets
import simulator_pictures
from matplotlib.figure import Figure
from mitsuba_scenes import SCENES, SIZE, SLOPES, VIEWS, apart_from_edges
from torch import Tensor

import lfref
from lfref.functional.psnr import psnr
from lfref.simulator.scene import Scene

IS_INSTALLED = importlib.util.find_spec("mitsuba") is not None
if IS_INSTALLED:
    from mitsuba_scenes import MitsubaScene
TWO_NOISES = 10 * math.log10(2)
"""Decibels by which two noisy pictures differ more from each other than each from what it should be."""


def picture() -> Figure:
    """The wall in focus through a round aperture, ours and Mitsuba's."""
    cells: list[tuple[str, Tensor]] = []
    for scene in SCENES[:2]:
        (ours,), theirs = _truth(scene("disc"), SLOPES[:1]), MitsubaScene(scene("disc")).through_disc(SLOPES[0])
        cells += [(f"{scene.__name__}, ours", ours), ("Mitsuba", theirs), simulator_pictures.difference(ours, theirs)]
    return sheets.sheet(cells, bar="absolute difference", **simulator_pictures.DIFFERENCE)


def table() -> Iterator[str]:
    """The least PSNR of views and truth of each scene, and of Mitsuba's pictures against others of its own."""
    yield "| scene | views, dB | apart from edges, dB | truth, disc, dB | truth, square, dB | Mitsuba's noise, dB |"
    yield "|---|---|---|---|---|---|"
    for scene in (*SCENES, mitsuba_scenes.matte):
        views = _views(scene())
        values = [_least(psnr, *views), _least(apart_from_edges, *views)]
        values += _truth_decibels(scene) if scene in SCENES else ()
        yield f"| {scene.__name__} | {' | '.join([*(f'{value:.1f}' for value in values), *[''] * (5 - len(values))])} |"
    yield ""
    yield f"Views of {SIZE[1]}x{SIZE[0]} pixels, 7x7; the least of {len(VIEWS)} views, and of slopes"
    yield f"{', '.join(f'{slope:g}' for slope in SLOPES)}. Noise is that of the truth through a disc."


PICTURES: dict[str, Callable[[], Figure]] = {"simulator_mitsuba.jpg": picture} if IS_INSTALLED else {}
TABLES: dict[str, Callable[[], Iterator[str]]] = {"mitsuba": table} if IS_INSTALLED else {}


def _truth(scene: Scene, slopes: tuple[float, ...]) -> Tensor:
    return lfref.simulate(scene, outputs=("truth",), slopes=slopes).truth


def _views(scene: Scene) -> tuple[list[Tensor], list[Tensor]]:
    """Some views, ours and Mitsuba's."""
    world, views = MitsubaScene(scene), lfref.simulate(scene, outputs=("views",), slopes=[0.0]).views
    return [views[view] for view in VIEWS], [world.view(u - 3, v - 3, samples=256) for v, u in VIEWS]


def _truth_decibels(scene: Callable[[str], Scene]) -> tuple[float, ...]:
    """Of truth through a disc and a square, and Mitsuba's noise."""
    world = MitsubaScene(scene("disc"))
    discs, others = ([world.through_disc(slope, seed=seed) for slope in SLOPES] for seed in (0, 1))
    squares = [world.through_square(slope) for slope in SLOPES]
    return (
        _least(psnr, _truth(scene("disc"), SLOPES), discs),
        _least(psnr, _truth(scene("square"), SLOPES), squares),
        _least(psnr, discs, others) + TWO_NOISES,
    )


def _least(measure: Callable[[Tensor, Tensor], Any], ours: Iterable[Tensor], theirs: Iterable[Tensor]) -> float:
    return min(float(measure(one, other)) for one, other in zip(ours, theirs, strict=True))
