"""Thinned captures: equal apertures, and a dense integral that is nearer to what a lens records."""

import pytest
import torch

from lfref.bench import thinning
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.io.read import read
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat, Noise

SLOPES = torch.tensor([-2.0, 0.5, 1.0], dtype=torch.float64)
SUM = OperatorRefocuser("sum", shift_and_sum)


@pytest.mark.parametrize(
    ("n_views", "step", "dense", "places", "end"),
    [
        (9, 2, 9, [0, 2, 4, 6, 8], 3 / 4),
        (9, 3, 9, [1, 4, 7], 1),
        (9, 4, 9, [0, 4, 8], 5 / 8),
        (14, 2, 13, [0, 2, 4, 6, 8, 10, 12], 3 / 4),
        (14, 3, 13, [0, 3, 6, 9, 12], 2 / 3),
        (3, 2, 3, [0, 2], 3 / 4),
    ],
)
def test_thinned_views_have_the_centre_and_the_aperture_of_all(n_views, step, dense, places, end):
    kept = thinning.axis(n_views, step)
    all_places = torch.arange(n_views, dtype=torch.float64)
    assert all_places[kept.thinned].tolist() == places
    assert all_places[kept.dense].mean() == all_places[kept.thinned].mean()
    assert len(all_places[kept.dense]) == dense
    assert kept.shares.tolist() == pytest.approx([end, *[1] * (len(places) - 2), end])
    # The cells that are left cover the dense ones, no more and no less.
    assert float(step * kept.shares.sum()) == pytest.approx(dense)


@pytest.mark.parametrize(("n_views", "step"), [(2, 2), (9, 1), (1, 2), (9, 9)])
def test_too_few_views_are_refused(n_views, step):
    with pytest.raises(InputError, match=rf"every {step} of {n_views}; set thin=2"):
        thinning.axis(n_views, step)


@pytest.fixture(scope="module")
def scene():
    """What 9x9 views see of a card before a wall, and what a lens over all of them records at half the slopes."""
    card = Surface(Plane(0.3), Checker(7.0, (0.9, 0.5, 0.1), (0.1, 0.2, 0.3)), Disc(14))
    surfaces = (
        Surface(Plane(-0.6), Noise((0.4,) * 3, (0.25,) * 3)),
        card,
        Surface(Plane(0.6), Flat(), Disc(2, (20, 5))),
    )
    return simulate(Scene(Camera((9, 9), (72, 88)), surfaces), slopes=SLOPES / 2)


def inner(stack):
    return stack[..., 12:-12, 12:-12]


def test_the_dense_integral_is_nearer_to_the_truth_than_what_is_judged_by_it(scene):
    (subject,) = thinning.thinned([LightField(scene.views, "capture")], 2, SLOPES)
    assert (subject.kind, subject.reference, subject.light.name) == ("thinned", "dense_integral", "capture")
    torch.testing.assert_close(subject.truth, exact_fourier(scene.views, SLOPES / 2))
    torch.testing.assert_close(subject.light.views, scene.views[::2, ::2])
    dense, sparse = (psnr(inner(each), inner(scene.truth)) for each in (subject.truth, subject.stack(SUM, SLOPES)))
    assert float((dense - sparse).min()) > 0
    assert float((dense - sparse)[0]) > 6  # far from focus, halving the step leaves a quarter of the error


def test_ends_that_count_less_bring_thinned_views_nearer_to_truth_and_integral(scene):
    (subject,) = thinning.thinned([LightField(scene.views)], 2, SLOPES)
    exact = OperatorRefocuser("exact", exact_fourier)
    cut, whole = subject.stack(exact, SLOPES), exact(subject.light, SLOPES)
    for reference in (scene.truth, subject.truth):
        better = psnr(inner(cut), inner(reference)) - psnr(inner(whole), inner(reference))
        assert float(better.min()) > 0.3


def test_weights_of_samples_are_thinned_too(scene):
    weight = (torch.rand(9, 9, 1, 72, 88) > 0.1).float()
    (subject,) = thinning.thinned([LightField(scene.views, weight=weight)], 3, SLOPES)
    assert torch.equal(subject.light.weight, weight[1::3, 1::3])


def test_of_a_real_capture_too_ends_that_count_less_are_nearer_to_the_integral(lytro):
    slopes = torch.tensor([-5.0, -2.0, 0.0], dtype=torch.float64)
    (subject,) = thinning.thinned([read(lytro, encoding="linear")], 2, slopes)
    window = (..., slice(24, -24), slice(24, -24))
    cut, whole = (
        psnr(stack[window], subject.truth[window]) for stack in (subject.stack(SUM, slopes), SUM(subject.light, slopes))
    )
    assert float((cut - whole).min()) > 1
    assert float(cut.min()) > 45
