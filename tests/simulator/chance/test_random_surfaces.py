"""Random parts of surfaces are legal for their camera, and of every kind."""

import pytest
import torch

from lfref.simulator import chance
from lfref.simulator.chance import Dice, Tone
from lfref.simulator.mattes import Outline
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.textures import Flat

CAMERA = Camera((3, 4), (36, 44))


def dice(seed):
    return Dice(torch.Generator().manual_seed(seed))


def test_outlines_are_of_every_kind():
    kinds = {type(chance.outline(dice(seed), CAMERA)) for seed in range(60)}
    assert kinds == {kind for kind in Outline.__subclasses__() if kind.__name__ != "Full"}


@pytest.mark.parametrize("camera", [Camera((1, 1), (8, 8)), CAMERA, Camera((15, 15), (64, 64))])
def test_domes_are_never_too_steep_for_their_camera(camera):
    heights = []
    for seed in range(20):
        dome = chance.dome(dice(seed), camera, 0.2, (-50.0, 50.0))
        Scene(camera, (Surface(dome, Flat()),))
        heights.append(dome.bulge)
    assert min(heights) < 0 < max(heights)


def test_domes_that_fit_have_the_height_that_was_drawn():
    assert all(0.1 <= chance.dome(dice(seed), CAMERA, 0.2, (0.1, 0.2)).bulge <= 0.2 for seed in range(20))


@pytest.mark.parametrize("name", chance.MATERIALS)
def test_materials_do_what_their_names_say(name):
    material = chance.MATERIALS[name](dice(1), Tone(1, 1), CAMERA, (-0.5, 0.5))
    assert type(material).__name__.lower() == name
    if name in ("mirror", "glass"):
        assert -0.5 <= material.disparity <= 0.5
