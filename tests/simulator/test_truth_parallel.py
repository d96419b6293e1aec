"""Planes of surfaces that face the camera: filters, what is left out, and closed forms against analytic transfers."""

import math

import numpy as np
import pytest
import torch

from lfref.functional.psnr import psnr
from lfref.simulator import aperture_cells, bitmaps, truth_parallel
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat, Noise


@pytest.mark.parametrize("width", [0.0, 0.4, 1.0, 2.5, 7.0, 40.3])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_taps_blur_as_much_as_a_box(width, share):
    taps = truth_parallel.box_taps(width, np.array([3 + share]))
    n = np.arange(len(taps)) - len(taps) // 2
    assert taps.sum() == pytest.approx(1)
    assert (taps * n**2).sum() + share * (1 - share) == pytest.approx(width**2 / 12)
    np.testing.assert_allclose(taps, taps[::-1])


def test_a_surface_in_focus_is_not_filtered():
    np.testing.assert_array_equal(truth_parallel.box_taps(0.0, np.array([5.0])), [0, 1, 0])


def sampled(*surfaces, size=(40, 50), slopes=(0.5,), aperture="square"):
    camera = Camera(size=size, aperture=aperture)
    layers = bitmaps.paint(Scene(camera, surfaces), reach=max(map(abs, slopes)))
    return truth_parallel.sampled(layers, camera, aperture_cells.aperture(camera), slopes)


FAR, NEAR = Surface(Plane(-1.0), Noise()), Surface(Plane(0.5), Noise())


def test_what_is_behind_an_opaque_surface_is_left_out():
    assert truth_parallel.visible(sampled(FAR, NEAR), 0.5) == [1]


def test_what_lies_outside_a_plane_is_left_out():
    island = Surface(Plane(0.5), Flat(), Disc(4.0, (38.0, 0.0)))
    layers = sampled(FAR, island, slopes=(0.5, -3.0))
    assert truth_parallel.visible(layers, 0.5) == [0]
    assert truth_parallel.visible(layers, -3.0) == [0, 1]


@pytest.mark.parametrize("aperture", ["square", "disc"])
@pytest.mark.parametrize("slope", [0.5, 0.0, -2.0])
def test_the_closed_form_is_what_cells_converge_to(aperture, slope):
    layers = sampled(FAR, slopes=(slope,), aperture=aperture)
    cells = aperture_cells.cut(layers.whole, 24)
    closed, summed = truth_parallel.alone(layers, slope), truth_parallel.together(layers, slope, cells)
    assert psnr(summed, closed) > 58


def test_threads_change_nothing(monkeypatch):
    island = Surface(Plane(0.5), Noise(), Disc(12.0))
    layers = sampled(FAR, island, slopes=(-1.0,))
    alone = truth_parallel.plane(layers, -1.0)
    monkeypatch.setattr(truth_parallel, "WORTH_A_THREAD", 1)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    assert torch.equal(truth_parallel.plane(layers, -1.0), alone)


def test_nothing_to_see_is_black():
    layers = sampled(Surface(Plane(0.0), Flat(), Disc(4.0, (300.0, 0.0))))
    assert not truth_parallel.plane(layers, 0.5).any()


def test_odd_sizes_read_the_same_samples_as_a_look_up():
    layers = sampled(FAR, size=(31, 44), slopes=(0.0,))
    camera = Camera(size=(31, 44))
    (layer,) = bitmaps.paint(Scene(camera, (FAR,)))
    centre = torch.zeros(1, dtype=torch.float64)
    expected = layer.seen(centre, centre, *camera.pixels())[0]
    margin = (layers.samples.shape[-1] // 2 - 44) // 2
    pixels = layers.samples[0, :, 2 * margin :, 2 * margin :][:, : 2 * 31 : 2, : 2 * 44 : 2]
    torch.testing.assert_close(pixels, expected)
    assert math.isclose(layers.disparities[0], -1.0)
