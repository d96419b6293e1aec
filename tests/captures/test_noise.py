"""Noise: known noise is measured, whatever the scene; nothing is changed."""

import dataclasses

import pytest
import torch

from lfref.captures.noise import NoiseDefect
from lfref.functional import noise_line
from lfref.lightfield import LightField
from lfref.simulator.effects.noise import noisy

from .scenes import clean


def found_in(field):
    return NoiseDefect(*noise_line.measure(field))


@pytest.mark.parametrize("name", ["gloss", "plane"])
@pytest.mark.parametrize(("shot", "read"), [(2e-3, 1e-4), (5e-4, 1e-5), (0.0, 1e-4)])
def test_noise_is_measured(name, shot, read):
    field = clean(name)
    views = noisy(field.views, shot, read, torch.randn(field.views.shape))
    defect = found_in(LightField(views))
    light = float(field.views.median())
    assert defect.deviation(light) == pytest.approx((shot * light + read) ** 0.5, rel=0.12)


def test_noise_of_an_even_picture_is_measured_to_a_hundredth():
    views = noisy(torch.rand(3, 3, 3, 1, 1).expand(-1, -1, -1, 200, 200), 1e-3, 1e-5, torch.randn(3, 3, 3, 200, 200))
    defect = found_in(LightField(views))
    assert defect.deviation(0.5) == pytest.approx((1e-3 * 0.5 + 1e-5) ** 0.5, rel=0.02)


def test_a_clean_scene_has_hardly_any():
    assert found_in(clean("shards")).deviation(0.5) < 0.003


def test_noise_is_reported_and_stays():
    field, defect = clean("shards"), NoiseDefect(1e-3, 1e-5)
    assert defect.corrected(field) is field
    assert "only measured: standard deviation 0.0045 at 0.01" in str(defect.reason_to_skip())


@pytest.mark.parametrize(
    "views", [torch.zeros(3, 3, 3, 40, 60), torch.rand(1, 1, 1, 4, 4), torch.ones(1, 2, 3, 30, 30)]
)
def test_flat_and_small_fields_have_no_noise(views):
    assert found_in(LightField(views)) == NoiseDefect()


def test_views_that_weigh_nothing_do_not_count():
    views = 0.5 + 0.01 * torch.randn(3, 3, 3, 64, 64)
    weight = torch.ones(3, 3, 1, 64, 64)
    views[0], weight[0] = torch.rand(3, 3, 64, 64), 0
    defect = found_in(dataclasses.replace(LightField(views), weight=weight))
    assert defect.deviation(0.5) == pytest.approx(0.01, rel=0.05)
