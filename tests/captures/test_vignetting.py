"""VignettingDefect: known gains come back, with and without a white picture; what has none stays as it is."""

import dataclasses

import pytest
import torch

from lfref.captures import vignetting
from lfref.captures.vignetting import VignettingDefect
from lfref.functional.psnr import psnr
from lfref.lightfield import LightField
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells
from lfref.refocuser.operators import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.vignetting import clipped_pupil, falloff
from lfref.simulator.simulate import simulate

from .scenes import ODD, clean, estimates, recorded, white


@pytest.fixture(scope="module")
def found():
    return vignetting.find(estimates(recorded("vignetting")))


def test_the_cats_eye_is_found_in_the_views_themselves(found):
    field = recorded("vignetting")
    expected = clipped_pupil(field.views, 0.5)
    relative = dataclasses.replace(found, falloff=0.0).gain(field)
    lit = expected > 0.2
    error = (relative / expected - 1).abs()[lit]
    assert float(error.median()) < 0.01
    assert float(error.quantile(0.95)) < 0.05


def test_depth_tells_the_falloff_that_all_views_share(found):
    field = recorded("vignetting")
    assert found.falloff == pytest.approx(0.36, rel=0.15)
    whole = falloff(field.views, 0.6) * clipped_pupil(field.views, 0.5)
    assert float((found.gain(field) / whole - 1).abs()[whole > 0.2].median()) < 0.02
    assert "falloff to 5" in found.summary()
    assert "unknown without a white picture" in dataclasses.replace(found, falloff=0.0).summary()


@pytest.mark.parametrize("name", [*ODD, "plane", "vignetting"])
def test_a_field_without_vignetting_has_none(name):
    assert vignetting.find(estimates(clean(name))).reason_to_skip() is not None


@pytest.mark.parametrize(
    "views", [torch.zeros(3, 3, 3, 40, 60), torch.ones(1, 1, 3, 40, 60), torch.rand(2, 2, 1, 8, 8)]
)
def test_where_little_is_to_be_seen_nothing_is_found(views):
    found = vignetting.find(estimates(LightField(views)))
    assert not found.is_known
    assert "unknown: too little" in str(found.reason_to_skip())


def test_a_white_picture_tells_every_gain():
    field, made = recorded("vignetting"), white("vignetting")
    found = vignetting.find(estimates(field, made))
    whole = falloff(field.views, 0.6) * clipped_pupil(field.views, 0.5)
    assert float((found.gain(field) - whole).abs().max()) < 3e-3
    assert "white picture, down to" in found.summary()


def test_an_even_white_picture_changes_nothing():
    even = LightField(0.8 + 0.002 * torch.randn(3, 3, 3, 40, 60))
    assert vignetting.find(estimates(LightField(torch.rand(3, 3, 3, 40, 60)), even)).reason_to_skip() is not None


def test_a_noisy_white_picture_of_an_even_lens_changes_nothing():
    assert "even" in str(vignetting.find(estimates(recorded("grainy"), white("grainy"))).reason_to_skip())


def test_dark_samples_weigh_less_and_black_ones_nothing():
    gain = torch.ones(3, 3, 1, 8, 8)
    gain[0, 0, 0, 0], gain[0, 0, 0, 1], gain[0, 0, 0, 2] = 0.0, 0.06, 0.5
    weight = torch.full((3, 3, 1, 8, 8), 0.5)
    corrected = VignettingDefect(white=gain).corrected(LightField(torch.full((3, 3, 3, 8, 8), 0.2), weight=weight))
    torch.testing.assert_close(corrected.weight[0, 0, 0, :4, 0], torch.tensor([0.0, 0.25, 0.5, 0.5]))
    torch.testing.assert_close(corrected.views[0, 0, 0, 1:3, 0], torch.tensor([0.2 / 0.06, 0.4]))
    assert bool(corrected.views.isfinite().all())
    full = VignettingDefect(white=gain.clamp(min=0.5)).corrected(LightField(torch.full((3, 3, 3, 8, 8), 0.2)))
    assert full.weight is None


def interior_psnr(field, truth, slopes):
    stack = OperatorRefocuser("cells", shift_and_sum_through_cells)(field, slopes)
    return float(psnr(stack[..., 24:-24, 24:-24], truth[..., 24:-24, 24:-24]).mean())


def test_refocused_pictures_come_near_the_truth_again(found):
    slopes, field = [-3.0, -1.0, -0.3, 0.25], recorded("vignetting")
    truth = simulate(sim30.SCENES["vignetting"], outputs=("truth",), slopes=slopes).truth
    told = vignetting.find(estimates(field, white("vignetting")))
    assert interior_psnr(field, truth, slopes) < 25
    assert interior_psnr(found.corrected(field), truth, slopes) > 40
    assert interior_psnr(told.corrected(field), truth, slopes) > 45
