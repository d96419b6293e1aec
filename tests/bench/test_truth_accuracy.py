"""The truth against brute force, the mean of very many true views: it is nearer to it than the best of our methods."""

import functools
import math
import random
from dataclasses import replace

import pytest
import torch

from lfref import geometry
from lfref.bench import accuracy, causes, evaluation
from lfref.functional.psnr import psnr
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import painting, sim30
from lfref.simulator.scene import Camera, Scene
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.simulate import PAPER, averaged, finer

SIZE = (96, 128)
CAP_DB = 85
"""Where a method is better than 75 dB, the truth need be no nearer to brute force than this."""
OPERATORS = [exact_fourier, shift_and_sum_antialiased, blockwise_wiener]


@functools.cache
def planes() -> list[tuple[Scene, float]]:
    """Scenes with a plane each: four of either version of sim30, two random ones, and twigs in the widest blur."""
    draw = random.Random(30)
    scenes = [
        replace(scenes[name], camera=replace(scenes[name].camera, size=SIZE))
        for scenes in sim30.VERSIONS.values()
        for name in draw.sample(sorted(scenes), 4)
    ]
    scenes += [RandomScenes(Camera(size=SIZE)).scene(30, 0, index) for index in range(2)]
    twigs = replace(sim30.SCENES["twigs"], camera=replace(sim30.CAMERA, size=SIZE))
    return [*((scene, draw.choice(PAPER.values)) for scene in scenes), (twigs, PAPER.values[0])]


def brute_force(scene: Scene, slope: float, times: int) -> torch.Tensor:
    """The mean of sharp pictures, `times` of them per pixel that the farthest surface moves, at least 24 in a row."""
    samples = scene.camera.samples
    fine = finer(scene, samples)
    layers = painting.paint(fine, reach=samples * abs(slope))
    far = max(abs(end - slope) for part in scene.surfaces for end in part.geometry.disparity_range(SIZE))
    n_points = times * max(24, math.ceil(max(scene.camera.grid) * far))
    return averaged(causes.through_points(layers, fine.camera, samples * slope, n_points), samples)


def inside(picture: torch.Tensor, scene: Scene, slope: float) -> torch.Tensor:
    """What all views cover, and 2 pixels less, which filters reach."""
    margin = math.ceil(geometry.corner_shift(torch.tensor([slope]), scene.camera.grid))
    return accuracy.without_border(picture, margin + 2)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(11))
def test_the_truth_is_10_db_nearer_to_brute_force_than_the_best_method(index):
    scene, slope = planes()[index]
    case = evaluation.ideal_case(scene, torch.tensor([slope]).double(), torch.device("cpu"))
    expected = inside(brute_force(scene, slope, 2), scene, slope)

    def decibels(picture: torch.Tensor) -> float:
        return float(psnr(inside(picture, scene, slope), expected))

    methods = [OperatorRefocuser(operator.__name__, operator) for operator in OPERATORS]
    with torch.no_grad():
        best = max(decibels(case.stack(method, torch.tensor([slope]).double())[0]) for method in methods)
    wanted = min(best + 10, CAP_DB)
    # The error of point sums falls at least by the square of their number along a side: what doubling changes is three
    # times the error that is left, 9.5 dB.
    half = decibels(brute_force(scene, slope, 1))
    got = decibels(case.reference[0])
    figures = (
        f"{scene.name}, slope {slope:.3f}: best method {best:.1f}, truth {got:.1f}, half as many points {half:.1f}"
    )
    assert half + 9.5 > wanted, figures
    assert got > wanted, figures
