"""A layer that is seen alone: one filter instead of all cells."""

import pytest
import torch

from lfref.functional.psnr import psnr
from lfref.simulator import bitmaps, scenery, truth, truth_together
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.scenery import FocalPlane, Scenery
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Noise


def plane(slope, aperture="square", grid=(7, 7), n_cells=9, matte=None, size=(40, 50)):
    camera = Camera(grid, size, aperture)
    surface = Surface(Plane(-1.0), Noise()) if matte is None else Surface(Plane(-1.0), Noise(), matte)
    layers = tuple(bitmaps.paint(Scene(camera, (surface,)), reach=abs(slope)))
    whole = Scenery(layers, camera, scenery.aperture(camera)).for_planes([slope])
    return FocalPlane(slope, whole, scenery.cut(whole.whole, n_cells))


@pytest.mark.parametrize("aperture", ["square", "disc"])
@pytest.mark.parametrize("grid", [(7, 7), (4, 7)])
@pytest.mark.parametrize("slope", [0.5, -1.0, -2.3])
@pytest.mark.parametrize("matte", [None, Disc(9.0, (14.0, -3.0))])
def test_the_filter_is_the_sum_of_all_cells(aperture, grid, slope, matte):
    one = plane(slope, aperture, grid, matte=matte)
    expected = truth_together.camera([one])(one)
    torch.testing.assert_close(truth.photograph(one), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("aperture", ["square", "disc"])
def test_matrices_make_what_loops_make(aperture, monkeypatch):
    one = plane(-2.3, aperture)
    expected = truth.photograph(one)
    monkeypatch.setattr(truth, "_add_compiled", truth._add_eager)
    torch.testing.assert_close(truth.photograph(one), expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(truth_together.photograph(one), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("aperture", ["square", "disc"])
def test_more_cells_do_not_change_the_picture(aperture):
    few, many = (truth.photograph(plane(0.5, aperture, n_cells=n_cells)) for n_cells in (7, 40))
    assert psnr(few, many) > 55
