"""Captures are corrected and inspected on a GPU as on the CPU: no tensors of both meet."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CODE = """
import dataclasses
import torch
from tests.pretended_gpu import WithGpu, on_gpu
import lfref
from lfref.simulator import sim30
from lfref.simulator.scene import Camera
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.effects.optics import Vignetting
from lfref.simulator.simulate import simulate

torch.manual_seed(0)
sensor = Sensor(vignetting=Vignetting(0.6, 0.5))
scene = dataclasses.replace(sim30.SCENES["leaves"], camera=Camera((5, 5), (96, 128)), sensor=sensor)
views = simulate(scene, outputs=["views"]).views.clamp(0, 1)
for k in range(20):
    views[k % 5, 3 * k % 5, k % 3, 10 + 3 * k, 20 + 4 * k] = 1.0  # hot
views[0, 0] = 0  # black
corner = torch.arange(96)[:, None] + torch.arange(128) < 24
for turn in ([], [-1], [-2], [-1, -2]):
    views[1:, 4].masked_fill_(corner.flip(turn), 0)
weight = torch.ones(5, 5, 1, 96, 128)
white = simulate(dataclasses.replace(scene, surfaces=scene.surfaces[:1]), outputs=["views"]).views.mean((2, 3, 4))
white = white[:, :, None, None, None].expand_as(views).contiguous()
for weighted, lit in ((None, white), (weight, None)):
    results = []
    for place in (lambda tensor: tensor, on_gpu):
        put = lambda tensor: None if tensor is None else place(tensor)
        field = lfref.LightField(put(views), weight=put(weighted))
        by = None if lit is None else lfref.LightField(put(lit))
        with WithGpu():
            corrected, corrections = lfref.correct(field, flat_field=by)
            inspection = lfref.inspect(field, by)
        assert corrected.views.is_cuda == (place is on_gpu)
        results.append((corrections.active, corrected.views.cpu(), inspection.disparity.cpu()))
    (names, views_on_cpu, disparity), (names_on_gpu, views_on_gpu, disparity_on_gpu) = results
    assert names == names_on_gpu and {"hot_pixels", "black_views"} <= set(names), (names, names_on_gpu)
    # On the CPU compiled loops sum in another order, from which all estimates follow.
    torch.testing.assert_close(views_on_cpu, views_on_gpu, atol=2e-3, rtol=0)
    assert float((disparity - disparity_on_gpu).abs().median()) < 0.01
print("done")
"""


@pytest.mark.slow
def test_captures_are_corrected_and_inspected_on_a_gpu_as_on_the_cpu():
    result = subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, capture_output=True, text=True, timeout=280)
    assert result.stdout == "done\n", result.stderr[-2000:]
