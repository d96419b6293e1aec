"""Views and truth against Mitsuba 3, which traces paths through the same camera and shares no code with ours."""

import functools

import pytest

import lfref
from tests.simulator.drawing import psnr

pytest.importorskip("mitsuba", reason="the extra `mitsuba` is not installed, or has no wheel for this machine")
from tests.simulator.path_tracer import SCENES, SLOPES, VIEWS, MitsubaScene, apart_from_edges

# Measured: 50 dB at least, where edges cut through pixels and where Mitsuba's pictures are noisy; else 69.8.
AT_LEAST = 47.0
APART_FROM_EDGES = 67.5

pytestmark = pytest.mark.slow
world = functools.cache(lambda scene: MitsubaScene(scene()))


@functools.cache
def simulated(scene, aperture="disc"):
    return lfref.simulate(scene(aperture), slopes=SLOPES)


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
@pytest.mark.parametrize("view", VIEWS)
def test_views_are_what_pinholes_record(scene, view):
    v, u = view
    ours, theirs = simulated(scene).views[v, u], world(scene).view(u - 3, v - 3, samples=256)
    assert psnr(ours, theirs) > AT_LEAST
    assert apart_from_edges(ours, theirs) > APART_FROM_EDGES


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
@pytest.mark.parametrize("plane", range(len(SLOPES)))
def test_truth_is_what_a_thin_lens_records(scene, plane):
    assert psnr(simulated(scene).truth[plane], world(scene).through_disc(SLOPES[plane])) > AT_LEAST


@pytest.mark.parametrize("scene", SCENES[:2], ids=lambda scene: scene.__name__)
def test_truth_is_what_a_square_lens_records(scene):
    truth = simulated(scene, "square").truth
    assert psnr(truth[2], world(scene).through_square(SLOPES[2])) > AT_LEAST


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_a_fiftieth_of_a_pixel_would_be_seen(scene):
    beside = world(scene).view(-3 + 0.02, -3, samples=256)
    assert apart_from_edges(simulated(scene).views[0, 0], beside) < APART_FROM_EDGES


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_another_focus_would_be_seen(scene):
    assert psnr(simulated(scene).truth[0], world(scene).through_disc(SLOPES[0] + 0.2)) < AT_LEAST
