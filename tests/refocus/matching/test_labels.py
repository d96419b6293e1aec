"""Slopes to try, and the best of them at each pixel."""

import pytest
import torch

from lfref.functional import neighbours
from lfref.refocus.disparity import matching
from lfref.refocus.disparity.cost_volume import grey_views
from tests.refocus.conftest import shifted_views, texture


@pytest.mark.parametrize(("first", "last"), [(-1.0, 1.0), (0.0, 0.25), (-0.3, -0.3)])
def test_slopes_reach_from_end_to_end_in_even_steps(first, last):
    slopes = matching.slopes_between(first, last)
    assert (float(slopes[0]), float(slopes[-1])) == pytest.approx((first, last))
    assert bool((slopes.diff() <= matching.STEP + 1e-9).all())


@pytest.mark.parametrize("disparity", [-0.35, 0.2])
def test_planes_are_found_between_steps_with_confidence(disparity):
    light = grey_views(
        shifted_views(neighbours.smoothed(texture(1, 48, 52), 1.0), disparity, (5, 5)).float(), torch.ones(5, 5)
    )
    found, confidence = matching.best_slopes(light, matching.slopes_between(-1, 1), 0.0, 1.0)
    assert float((found - disparity)[8:-8, 8:-8].abs().quantile(0.95)) < 0.05
    assert float(confidence[8:-8, 8:-8].median()) > 0.4
    assert float(confidence.max()) < 1
