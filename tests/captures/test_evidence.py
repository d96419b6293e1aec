"""Evidence: maps of the size of the views, found once; the real capture's range."""

import torch

from lfref.captures.estimates import Estimates
from lfref.io.read import read
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


def test_maps_have_the_size_of_the_views_and_are_found_once():
    evidence = Estimates(LightField(torch.rand(3, 3, 3, 201, 303)))
    assert evidence.coarse_disparity.factor > 1
    assert evidence.disparity.shape == evidence.confidence.shape == (201, 303)
    assert evidence.disparity is evidence.disparity


def test_the_disparity_of_a_simulated_scene_is_found():
    made = simulate(sim30.SCENES["shards"], outputs=["views", "disparity"])
    evidence = Estimates(LightField(made.views))
    error = (evidence.disparity - made.disparity).abs()
    assert error.median() < 0.01
    assert float((error[evidence.confidence > 0.5] < 0.1).float().mean()) > 0.9


def test_a_real_capture_is_believed_from_minus_one_and_a_half_to_one_half(lytro):
    evidence = Estimates(read(lytro, encoding="linear"))
    assert evidence.reference == (4, 4)
    sure = evidence.disparity[evidence.confidence > 0.5]
    assert sure.numel() > 0.9 * evidence.disparity.numel()
    low, high = sure.quantile(torch.tensor([0.02, 0.98])).tolist()
    assert -1.5 < low < -1
    assert 0 < high < 0.5
