"""Results of the methods on one fixed noisy capture stay as they are, so that a changed constant is noticed.

The expected values, means of blocks, lie in results.npz, compared with a tolerance, since other machines round
differently. After a change on purpose: say it in CHANGELOG.md, raise the versions of caches where test_versions asks
for it, and write the file anew by `python -m tests.refocus.test_results`.
"""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.disparity.disparity_map import disparity_map
from lfref.refocus.focus import slope_range
from lfref.refocus.focus.all_in_focus import all_in_focus, extended_focus
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.super_resolution import predicted_views, super_resolve
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate

EXPECTED = Path(__file__).with_name("results.npz")
SLOPES = torch.tensor([-1.4, 0.3, 1.1], dtype=torch.float64)


@functools.cache
def views() -> Tensor:
    """A scene of several surfaces, with noise, [7, 7, 3, 72, 96]."""
    scene = sim30.SCENES["shards"]
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, size=(72, 96)))
    clean = simulate(scene, outputs=("views",)).views
    return clean + 0.01 * torch.randn(clean.shape, generator=torch.Generator().manual_seed(0))


def wall() -> Tensor:
    """A wall at slope .3 with detail beyond the pixels, and a little noise, [5, 5, 1, 48, 60]."""
    fine = torch.rand(1, 1, 96, 120, generator=torch.Generator().manual_seed(1))
    fine = F.avg_pool2d(F.pad(fine, (1, 1, 1, 1), mode="circular"), 3, 1)[0]
    clean = predicted_views(fine, 0.3, 2, (5, 5)).movedim(0, 2)
    return clean + 0.002 * torch.randn(clean.shape, generator=torch.Generator().manual_seed(2))


def reduced() -> tuple[Tensor, ...]:
    small = slope_range.reduce_views(views())
    coarse = slope_range.disparity_of_reduced(small)
    ends = slope_range.slope_range(coarse)
    assert ends is not None
    return coarse.disparity, coarse.confidence, slope_range.on_surfaces(coarse).float(), torch.tensor(ends)


RESULTS = {
    "disparity": lambda: tuple(disparity_map(views())),
    "slope range": reduced,
    "cells": lambda: (shift_and_sum_antialiased(views(), SLOPES),),
    "layers": lambda: (refocus_by_layers(views(), SLOPES),),
    "occlusion aware": lambda: (blockwise_wiener(views(), SLOPES),),
    "super resolution": lambda: (super_resolve(wall(), SLOPES[1:]),),
    "all in focus": lambda: tuple(all_in_focus(shift_and_sum(views(), torch.linspace(-2, 2, 9).double()))),
    "extended focus": lambda: (extended_focus(views()),),
}


def in_blocks(result: Tensor) -> Tensor:
    """Means of blocks of 12 x 12 pixels, in a row."""
    maps = result.detach().float()
    if maps.ndim < 2:
        return maps
    return F.avg_pool2d(maps.reshape(1, -1, *maps.shape[-2:]), min(12, *maps.shape[-2:])).flatten()


def computed(name: str) -> np.ndarray:
    return torch.cat([in_blocks(part) for part in RESULTS[name]()]).numpy()


TOLERANCES = {"slope range": 5e-4}
"""Where almost equal costs decide a disparity, processors differ in some pixels: AMD's and Intel's by 1.3e-4."""


@pytest.mark.parametrize("name", RESULTS)
def test_results_are_those_that_were_stored(name: str) -> None:
    tolerance = TOLERANCES.get(name, 2e-5)
    with np.load(EXPECTED) as stored:
        np.testing.assert_allclose(computed(name), stored[name], atol=tolerance, rtol=2e-5)


if __name__ == "__main__":
    np.savez_compressed(EXPECTED, **{name: computed(name) for name in RESULTS})
