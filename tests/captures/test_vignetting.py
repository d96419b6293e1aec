"""Vignetting: known gains are estimated, with and without a flat field; views without vignetting stay."""

import dataclasses
import math

import pytest
import torch

from lfref import geometry
from lfref.captures import vignetting
from lfref.captures.brightness import Ratios
from lfref.captures.registration import positions_of
from lfref.captures.vignetting import NO_LENS, VignettingDefect
from lfref.functional.psnr import psnr
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.optics import clipped_pupil, falloff
from lfref.simulator.simulate import simulate

from .scenes import ODD, clean, ratios, recorded, white

FIELD = LightField(torch.ones(7, 7, 1, 64, 96))
RADIUS = math.hypot(7, 7) / 2


@pytest.fixture(scope="module")
def defect():
    return vignetting.find(ratios(recorded("vignetting")))


def test_the_cats_eye_is_estimated_from_the_views_and_falloff_from_their_depth(defect):
    field = recorded("vignetting")
    rim, whole = clipped_pupil(field.views, 0.5), falloff(field.views, 0.6) * clipped_pupil(field.views, 0.5)
    no_falloff = dataclasses.replace(defect, lens=(0.0, *defect.lens[1:]))
    error = (no_falloff.gain(field) / rim - 1).abs()[rim > 0.2]
    assert float(error.median()) < 0.01
    assert float(error.quantile(0.95)) < 0.05
    assert defect.lens[0] == pytest.approx(0.36, rel=0.15)
    assert float((defect.gain(field) / whole - 1).abs()[whole > 0.2].median()) < 0.02
    assert "share: 5" in defect.summary()
    assert "unknown without a flat field" in no_falloff.summary()


@pytest.mark.parametrize("name", [*ODD, "plane", "vignetting"])
def test_a_field_without_vignetting_has_none(name):
    assert isinstance(vignetting.find(ratios(clean(name))), str)


@pytest.mark.parametrize("name", ["gloss", "window"])
def test_falloff_of_a_lens_behind_gloss_is_not_corrected_too_far(name):
    field = clean(name)
    for tangent, eye in ((0.6, 0.5), (0.3, 0.25), (0.0, 0.5)):
        whole = falloff(field.views, tangent) * clipped_pupil(field.views, eye)
        shaded = dataclasses.replace(field, views=field.views * whole)
        defect = vignetting.find(ratios(shaded))
        after = ((defect.corrected(shaded).views - field.views) * (whole > 0.1)).square().mean()
        assert float(after) < float((shaded.views - field.views).square().mean())


def pupil(views, falloff, shift):
    """Light of a pupil that is darker towards its rim, 1 / (1 + falloff |p - shift x|^2)^2, [V, U, 1, H, W]."""
    y, x, q, p = coordinates(views)
    return (1 + falloff * ((q - shift * y).square() + (p - shift * x).square()))[:, :, None] ** -2


def coordinates(views):
    """`y x q p` of samples [V, U, C, H, W], as in `vignetting`."""
    y, x = (2 * geometry.angular_offsets(length).float() / math.hypot(*views.shape[-2:]) for length in views.shape[-2:])
    q, p = (geometry.angular_offsets(n_views).float() for n_views in views.shape[:2])
    return y[:, None], x, q[:, None, None, None], p[:, None, None]


@pytest.mark.parametrize("name", [*ODD, "plane", "vignetting", "floor"])
@pytest.mark.parametrize(("falloff_of_pupil", "shift"), [(0.01, 1.0), (0.02, 2.0), (0.02, 0.0), (1e-3, 16.0)])
def test_smooth_shading_is_no_rim_and_is_corrected(name, falloff_of_pupil, shift):
    # The last is a falloff about a centre that moves with the view, (1 + .25 |x - p / 16|^2)^-2.
    field = clean(name)
    gain = pupil(field.views, falloff_of_pupil, shift)
    defect = vignetting.find(ratios(dataclasses.replace(field, views=(field.views * gain).clamp(max=1))))
    lens = NO_LENS if isinstance(defect, str) else defect.lens
    assert not lens[1]
    # What a view has throughout is its exposure, and what all views share may stay.
    shares = [
        image.log() - image.log().mean((-2, -1), keepdim=True)
        for image in (gain, vignetting.lens_gain(lens, *coordinates(field.views))[:, :, None])
    ]
    true, found = (share - share[3, 3] for share in shares)
    assert float((true - found).square().mean()) <= max(4e-5, 0.06 * float(true.square().mean()))


def test_gains_of_a_rim_are_those_of_the_simulator():
    places = coordinates(FIELD.views)
    lens = (0.36, 0.5 * RADIUS, RADIUS, *NO_LENS[3:])
    torch.testing.assert_close(vignetting.rim_gain(lens, *places)[:, :, None], clipped_pupil(FIELD.views, 0.5))
    gain = vignetting.lens_gain((0.36, *NO_LENS[1:]), *places)[:, :, None]
    torch.testing.assert_close(gain, falloff(FIELD.views, 0.6).expand_as(gain))


def ratios_of(lens, noise, disparity):
    """Ratios of a lens and windows at some disparities, [n]."""
    y, x = torch.meshgrid(torch.linspace(-0.5, 0.5, 12), torch.linspace(-0.8, 0.8, 18), indexing="ij")
    q, p = (places.float()[..., None] for places in positions_of(FIELD).unflatten(0, (7, 7)).movedim(-1, 0))
    rows, columns = ((place.flatten() + step * disparity).expand(7, 7, -1) for place, step in ((y, q), (x, p)))
    own = vignetting.lens_gain(lens, rows, columns, q, p)
    log = (own / own[3, 3]).clamp(min=0.02).log() + noise * torch.randn(7, 7, y.numel())
    known = torch.ones(7, 7, y.numel(), dtype=bool)
    return Ratios(log[:, :, None], known, torch.stack([rows, columns]), torch.stack([q, p]), (12, 18), (3, 3))


@pytest.mark.parametrize("rim", [(0.3, 1.5, RADIUS), (0.0, 3.0, RADIUS), (0.0, 2.0, 4.0)])
def test_a_rim_is_fitted(rim):
    found = vignetting.find(ratios_of((*rim, *NO_LENS[3:]), 0.01, 0.1 * torch.rand(216) - 0.06)).lens
    assert found[1:3] == pytest.approx(rim[1:], abs=0.06)
    assert found[0] == pytest.approx(rim[0], abs=0.06)
    assert not any(found[3:])


def test_a_white_picture_gives_every_gain():
    field = recorded("vignetting")
    by_white = vignetting.find_by_flat_field(white("vignetting"))
    whole = falloff(field.views, 0.6) * clipped_pupil(field.views, 0.5)
    assert float((by_white.gain(field) - whole).abs().max()) < 3e-3
    assert "flat field, down to" in by_white.summary()


@pytest.mark.parametrize(("gain", "is_corrected"), [(0.988, True), (0.992, False)])
def test_a_white_picture_counts_if_it_lacks_a_hundredth_of_the_light(gain, is_corrected):
    views = torch.full((3, 3, 1, 60, 80), 0.8)
    views[..., :16] *= gain
    assert isinstance(vignetting.find_by_flat_field(LightField(views)), VignettingDefect) == is_corrected


def test_dark_samples_weigh_less_and_black_ones_nothing():
    gain = torch.ones(3, 3, 1, 8, 8)
    gain[0, 0, 0, 0], gain[0, 0, 0, 1], gain[0, 0, 0, 2] = 0.0, 0.06, 0.5
    weight = torch.full((3, 3, 1, 8, 8), 0.5)
    corrected = VignettingDefect(flat_field=gain).corrected(LightField(torch.full((3, 3, 3, 8, 8), 0.2), weight=weight))
    torch.testing.assert_close(corrected.weight[0, 0, 0, :4, 0], torch.tensor([0.0, 0.25, 0.5, 0.5]))
    torch.testing.assert_close(corrected.views[0, 0, 0, 1:3, 0], torch.tensor([0.2 / 0.06, 0.4]))
    assert bool(corrected.views.isfinite().all())
    # Untrusted samples stay as they are.
    torch.testing.assert_close(corrected.views[0, 0, 0, 0], torch.full((8,), 0.2))
    full = VignettingDefect(flat_field=gain.clamp(min=0.5)).corrected(LightField(torch.full((3, 3, 3, 8, 8), 0.2)))
    assert full.weight is None


def interior_psnr(field, truth, slopes):
    stack = OperatorRefocuser("cells", shift_and_sum_antialiased)(field, slopes)
    return float(psnr(stack[..., 24:-24, 24:-24], truth[..., 24:-24, 24:-24]).mean())


def test_corrected_pictures_are_near_the_truth(defect):
    slopes, field = [-1.0, 0.25], recorded("vignetting")
    truth = simulate(sim30.SCENES["vignetting"], outputs=("truth",), slopes=slopes).truth
    assert interior_psnr(field, truth, slopes) < 25
    assert interior_psnr(defect.corrected(field), truth, slopes) > 40
    assert interior_psnr(vignetting.find_by_flat_field(white("vignetting")).corrected(field), truth, slopes) > 45


def shaded():
    x = torch.linspace(-1, 1, 60)
    shade = 1 - 0.4 * x.square()[:, None] - 0.3 * x.square()
    views = 0.7 * shade.expand(3, 3, 3, -1, -1).clone()
    views[:, :, 2] *= 0.5
    return views


def test_noise_is_smoothed_away_and_dust_stays():
    field = shaded()
    noisy = field + 0.01 * torch.randn(field.shape)
    exact, _ = vignetting.flat_field_gain(field)
    gains, estimated = vignetting.flat_field_gain(noisy)
    error = float((gains - exact)[..., 10:-10, 10:-10].std())
    assert error < 0.005
    assert error == pytest.approx(estimated, rel=0.5)
    field[0, 0, :, 20, 20] *= 0.5
    dusty = float(vignetting.flat_field_gain(field)[0][0, 0, 0, 20, 20])
    assert dusty == pytest.approx(0.5 * float(exact[0, 0, 0, 20, 20]), rel=0.02)
