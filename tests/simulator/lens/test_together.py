"""Several layers through every cell: compiled loops against PyTorch's operations, and threads that change nothing."""

import pytest
import torch
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from lfref.simulator import bitmaps, scenery, truth, truth_together
from lfref.simulator.materials import Glossy, Mirror
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.scenery import FocalPlane, Scenery, visible
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Noise
from tests.simulator import drawing

FAR = Surface(Plane(-1.0), Noise())
KINDS = {
    "islands": (FAR, Surface(Plane(0.5), Noise(), Disc(12.0))),
    "slanted": (FAR, Surface(Plane(0.2, (0.01, 0.004)), Noise(), Disc(12.0))),
    "dome": (Surface(Dome(0.0, 0.9, 26.0), Noise()),),
    "crossing": (Surface(Plane(0.0, (0.02, 0.0)), Noise()), Surface(Plane(0.0, (-0.02, 0.01)), Noise()), FAR),
    "glossy": (FAR, Surface(Dome(0.2, 0.4, 20.0), Noise(), Disc(12.0), Glossy(0.6, 8.0, 5.0))),
    "mirror": (FAR, Surface(Plane(0.4), Noise(), Disc(12.0), Mirror(0.7, Checker(9.0), -1.5))),
}


def planes(scene, slopes, n_cells=4):
    layers = tuple(bitmaps.paint(scene, reach=max(map(abs, slopes))))
    whole = Scenery(layers, scene.camera, scenery.aperture(scene.camera)).for_planes(slopes)
    cells = scenery.cut(whole.whole, n_cells)
    return [FocalPlane(slope, whole.only(visible(whole, slope)), cells) for slope in slopes]


@pytest.mark.parametrize("name", list(KINDS))
def test_loops_make_what_pytorch_makes(name):
    scene = Scene(Camera((5, 7), (26, 30), "disc"), KINDS[name])
    found = planes(scene, [-2.0, 0.1])
    photograph = truth_together.camera(found)
    for plane in found:
        torch.testing.assert_close(photograph(plane), truth_together.photograph(plane), atol=1e-6, rtol=0)


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(drawing.SCENES, st.floats(-3, 3))
def test_any_legal_scene_is_photographed_alike(scene, slope):
    (plane,) = planes(scene, [slope], n_cells=3)
    assume(plane.seen.layers)
    picture = truth_together.camera([plane])(plane)
    assert bool(picture.isfinite().all())
    torch.testing.assert_close(picture, truth_together.photograph(plane), atol=2e-6, rtol=1e-5)


@pytest.mark.parametrize("name", ["islands", "crossing"])
def test_threads_change_nothing(name, monkeypatch):
    (plane,) = planes(Scene(Camera(size=(40, 50)), KINDS[name]), [-1.0])
    alone = truth_together.camera([plane])(plane)
    monkeypatch.setattr(truth_together, "WORTH_A_THREAD", 1)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    assert torch.equal(truth_together.camera([plane])(plane), alone)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", list(KINDS))
def test_a_gpu_photographs_the_same(name):
    scene = Scene(Camera((5, 7), (26, 30), "disc"), KINDS[name])
    here, there = (
        truth.stack(bitmaps.paint(scene, device, 2.0), scene.camera, [-2.0, 0.1]) for device in ("cpu", "cuda")
    )
    assert there.is_cuda
    torch.testing.assert_close(there.cpu(), here, atol=1e-5, rtol=0)
