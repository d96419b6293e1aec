"""The model that ships: nearer to the truth than the method that it corrects, and nothing where there is nothing."""

import dataclasses

import pytest
import torch

import lfref
from lfref.functional.psnr import psnr
from lfref.lightfield import LightField
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.simulator import sim30
from lfref.simulator.effects.noise import noisy

SLOPES = torch.tensor([-0.6, 0.0, 0.3], dtype=torch.float64)
INNER = (..., slice(12, -12), slice(12, -12))


@pytest.fixture(scope="module")
def made():
    scene = sim30.SCENES["twigs"]
    small = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, size=(128, 144)))
    return lfref.simulate(small, outputs=("views", "truth"), slopes=SLOPES)


@pytest.mark.parametrize(("noise", "gain"), [(0.0, 0.5), (4e-4, 1.0)])
def test_its_pictures_are_nearer_to_the_truth(made, noise, gain):
    views = noisy(made.views, 0.0, noise, torch.randn(made.views.shape)) if noise else made.views
    before, after = (
        psnr(stack[INNER], made.truth[INNER])
        for stack in (occlusion_aware(views, SLOPES), lfref.load()(LightField(views), SLOPES))
    )
    assert float((after - before).mean()) > gain
    assert float((after - before).min()) > -0.3


def test_its_pictures_are_as_bright_as_the_truth(made):
    stack = lfref.load()(LightField(made.views), SLOPES)
    ratio = stack[INNER].mean((1, 2, 3)) / made.truth[INNER].mean((1, 2, 3))
    torch.testing.assert_close(ratio, torch.ones(3), atol=3e-3, rtol=0)


@pytest.mark.parametrize("light", [0.0, 0.3, 1.0])
def test_what_is_constant_stays_so(light):
    stack = lfref.load()(torch.full((5, 5, 3, 64, 70), light), [-0.5, 0.25])
    torch.testing.assert_close(stack, torch.full_like(stack, light), atol=1e-4, rtol=0)
