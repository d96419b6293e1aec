"""Captures are corrected and inspected on a GPU as on the CPU."""

import dataclasses

import pytest
import torch

import lfref
from lfref.simulator import sim30
from lfref.simulator.effects.optics import Vignetting
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Camera
from lfref.simulator.simulate import simulate


@pytest.mark.gpu
def test_captures_are_corrected_and_inspected_on_a_gpu_as_on_the_cpu():
    sensor = Sensor(vignetting=Vignetting(0.6, 0.5))
    scene = dataclasses.replace(sim30.SCENES["leaves"], camera=Camera((5, 5), (96, 128)), sensor=sensor)
    views = simulate(scene, outputs=["views"]).views.clamp(0, 1)
    for k in range(20):
        views[k % 5, 3 * k % 5, k % 3, 10 + 3 * k, 20 + 4 * k] = 1.0  # hot
    views[0, 0] = 0  # black
    results = []
    for device in ("cpu", "cuda"):
        field = lfref.LightField(views, weight=torch.ones(5, 5, 1, 96, 128)).to(torch.device(device))
        corrected, corrections = lfref.correct(field)
        results.append((corrections.active, corrected.views.cpu(), lfref.inspect(field).disparity.cpu()))
    (names, on_cpu, disparity), (names_on_gpu, on_gpu, disparity_on_gpu) = results
    assert names == names_on_gpu
    # On the CPU compiled loops sum in another order, from which all estimates follow.
    torch.testing.assert_close(on_cpu, on_gpu, atol=2e-3, rtol=0)
    assert float((disparity - disparity_on_gpu).abs().median()) < 0.01
