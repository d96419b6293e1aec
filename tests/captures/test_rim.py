"""The rim of a lens: the simulator's own model, undone; a lens without one has none."""

import math

import pytest
import torch

from lfref import geometry
from lfref.captures import vignetting
from lfref.captures.brightness import Ratios
from lfref.captures.registration import positions_of
from lfref.captures.vignetting import Rim
from lfref.lightfield import LightField
from lfref.simulator.effects.vignetting import clipped_pupil, falloff

FIELD = LightField(torch.ones(7, 7, 1, 64, 96))
PLACES = [2 * geometry.angular_offsets(length).float() / math.hypot(64, 96) for length in (64, 96)]
RADIUS = math.hypot(7, 7) / 2


def test_gains_are_those_of_the_simulator():
    y, x = PLACES
    q, p = (places[:, :, None, None].float() for places in positions_of(FIELD).unflatten(0, (7, 7)).movedim(-1, 0))
    made = Rim(0.36, 0.5 * RADIUS, RADIUS)
    torch.testing.assert_close(
        vignetting.rim_gain(made, y[:, None], x, q, p)[:, :, None], clipped_pupil(FIELD.views, 0.5)
    )
    torch.testing.assert_close(vignetting.falloff_gain(made, y[:, None], x), falloff(FIELD.views, 0.6))


def made_ratios(lens, noise, disparity):
    """Ratios that a lens makes of windows at some disparities."""
    y, x = torch.meshgrid(torch.linspace(-0.5, 0.5, 12), torch.linspace(-0.8, 0.8, 18), indexing="ij")
    q, p = (places.float()[..., None] for places in positions_of(FIELD).unflatten(0, (7, 7)).movedim(-1, 0))
    rows, columns = ((place.flatten() + step * disparity).expand(7, 7, -1) for place, step in ((y, q), (x, p)))
    own = vignetting.rim_gain(lens, rows, columns, q, p) * vignetting.falloff_gain(lens, rows, columns)
    log = (own / own[3, 3]).clamp(min=0.02).log() + noise * torch.randn(7, 7, y.numel())
    return Ratios(
        log[:, :, None],
        torch.ones(7, 7, y.numel(), dtype=bool),
        torch.stack([rows, columns]),
        torch.stack([q, p]),
        (12, 18),
        (3, 3),
    )


@pytest.mark.parametrize("lens", [Rim(0.3, 1.5, RADIUS), Rim(0.0, 3.0, RADIUS), Rim(0.1, 2.0, 4.0)])
def test_a_lens_is_found_again(lens):
    disparity = 0.03 * torch.rand(216) - 0.02
    fit = vignetting.fit_rim(made_ratios(lens, 0.01, disparity), 0.01)
    assert fit.rim.displacement == pytest.approx(lens.displacement, abs=0.06)
    assert fit.rim.radius == pytest.approx(lens.radius, abs=0.06)
    assert fit.rim.falloff == pytest.approx(lens.falloff, abs=4 * fit.falloff_error)
    assert 0.001 < fit.falloff_error < 0.1


def test_falloff_that_all_views_share_is_told_by_depth_alone():
    lens = Rim(0.3, 1.5, RADIUS)
    flat = vignetting.fit_rim(made_ratios(lens, 0.01, torch.zeros(216)), 0.01)
    deep = vignetting.fit_rim(made_ratios(lens, 0.01, 0.04 * torch.rand(216)), 0.01)
    assert deep.falloff_error < 0.1 * flat.falloff_error or flat.falloff_error < 1e-6
    assert abs(deep.rim.falloff - 0.3) < 0.05


def test_views_that_differ_by_noise_and_exposure_have_no_rim():
    ratios = made_ratios(Rim(), 0.02, torch.zeros(216))
    ratios = ratios._replace(log=ratios.log + 0.3 * torch.rand(7, 7, 1, 1))
    assert vignetting.fit_rim(ratios, 0.02).rim.displacement == 0
