"""Several layers through every cell: compiled loops against PyTorch's operations, and threads that change nothing."""

import pytest
import torch
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from lfref.simulator import focal_planes, painting, truth, truth_cells
from lfref.simulator.materials import Glossy, Mirror
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Noise
from lfref.simulator.truth_cells import CellRenderer
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
    layers = painting.paint(scene, reach=max(map(abs, slopes)))
    return focal_planes.focal_planes(layers, scene.camera, slopes, n_cells)


@pytest.mark.parametrize("name", list(KINDS))
def test_loops_render_as_pytorch_does(name):
    both = planes(Scene(Camera((5, 7), (26, 30), "disc"), KINDS[name]), [-2.0, 0.1])
    renderer = CellRenderer(both)
    for plane in both:
        expected = truth_cells.render_eagerly(plane)
        torch.testing.assert_close(renderer.render(plane), expected, atol=1e-6, rtol=0)


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(drawing.SCENES, st.floats(-3, 3))
def test_any_valid_scene_is_rendered_alike(scene, slope):
    (plane,) = planes(scene, [slope], n_cells=3)
    assume(plane.layers)
    picture = CellRenderer([plane]).render(plane)
    assert bool(picture.isfinite().all())
    torch.testing.assert_close(picture, truth_cells.render_eagerly(plane), atol=2e-6, rtol=1e-5)


@pytest.mark.parametrize("name", ["islands", "crossing"])
def test_threads_change_nothing(name, monkeypatch):
    (plane,) = planes(Scene(Camera(size=(40, 50)), KINDS[name]), [-1.0])
    expected = CellRenderer([plane]).render(plane)
    monkeypatch.setattr(truth_cells, "WORTH_A_THREAD", 1)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    assert torch.equal(CellRenderer([plane]).render(plane), expected)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", list(KINDS))
def test_a_gpu_photographs_the_same(name):
    scene = Scene(Camera((5, 7), (26, 30), "disc"), KINDS[name])
    cpu, gpu = (
        truth.stack(painting.paint(scene, device, 2.0), scene.camera, [-2.0, 0.1]) for device in ("cpu", "cuda")
    )
    assert gpu.is_cuda
    torch.testing.assert_close(gpu.cpu(), cpu, atol=1e-5, rtol=0)
