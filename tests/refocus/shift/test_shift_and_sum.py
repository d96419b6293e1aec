"""Shift-and-sum through cells: points among the scene's disparities, cells beyond, and nearer the truth for it."""

import dataclasses

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import batches
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.scene import analyze_scene
from lfref.refocus.shift.shift_and_sum import coverage, shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import shifted_views, texture


@pytest.mark.parametrize(("interpolation", "error"), [("linear", 0.02), ("cubic", 0.004)])
def test_cells_of_all_the_aperture_are_the_integral_over_it(plane, interpolation, error):
    views, _ = plane(0.0)
    slopes = [-1.3, 0.25, 0.9]
    filled = shift_and_sum(views, slopes, interpolation, "wrap", fill_factor=1.0)
    assert (filled - exact_fourier(views, slopes, fill_factor=1.0)).square().mean().sqrt() < error


def test_coverage_counts_the_weighted_views_with_a_sample():
    weights = torch.tensor([[1.0, 2.0, 1.0]])
    share = coverage([1.5], (1, 3), (4, 6), weights=weights)[0]
    # The left view reads at x - 1.5, the right one at x + 1.5.
    expected = torch.tensor([0.75, 0.75, 1.0, 1.0, 0.75, 0.75], dtype=torch.float64)
    torch.testing.assert_close(share, expected.expand(4, 6))


@pytest.mark.parametrize(
    "change",
    [
        {"slopes": [float("nan")]},
        {"slopes": []},
        {"slopes": [5.0]},
        {"interpolation": "magic"},
        {"border": "mirror"},
        {"fill_factor": -1.0},
        {"fill_factor": 1.0, "disparity": float("nan")},
        {"fill_factor": 30.0},
    ],
)
def test_bad_arguments_are_refused(change):
    with pytest.raises(InputError):
        shift_and_sum(**({"views": torch.rand(3, 3, 1, 10, 10), "slopes": [0.5]} | change))


@pytest.mark.parametrize("name", ["wide_near_5", "wide_both_5", "wide_steps_5"])
def test_planes_among_disparities_of_wide_baselines_stay_points(name):
    scene = sim30.WIDE[name]
    views = simulate(scene, outputs=["views"], slopes=[0.0]).views
    planes = [surface.geometry.form.disparity for surface in scene.surfaces]
    assert torch.equal(shift_and_sum_antialiased(views, planes), shift_and_sum(views, planes, "spline"))


@pytest.mark.parametrize("name", ["edge", "discs", "twigs"])
def test_wide_blur_has_no_copies(name):
    scene = dataclasses.replace(sim30.SCENES[name], sensor=sim30.IDEAL)
    made = simulate(scene, slopes=[-7.0, -3.0])
    inner = (..., slice(24, -24), slice(24, -24))

    def error(stack: torch.Tensor) -> torch.Tensor:
        return (stack - made.truth)[inner].square().mean((1, 2, 3))

    points, cells = shift_and_sum(made.views, made.slopes), shift_and_sum_antialiased(made.views, made.slopes)
    assert bool((error(cells) < error(points) / 8).all())  # 9 dB


def smooth_views(disparity: float, grid: tuple[int, int] = (7, 7), side: int = 160) -> torch.Tensor:
    """A plane of soft texture, which small pictures of the views still show."""
    torch.manual_seed(5)
    waves = texture(1, side // 8, side // 8)[:, :, None, :, None].expand(-1, -1, 8, -1, 8)
    soft = torch.fft.rfft2(waves.reshape(1, side, side))
    soft[..., side // 16 : -(side // 16), :] = 0
    soft[..., side // 16 :] = 0
    return shifted_views(torch.fft.irfft2(soft, s=(side, side)), disparity, grid)


@pytest.mark.parametrize("disparity", [-3.0, -1.0, 0.0, 0.4, 2.0])
def test_one_plane_is_found(disparity):
    seen = analyze_scene(smooth_views(disparity)).ends
    assert seen.low - 0.01 <= seen.middle <= seen.high + 0.01
    assert float(seen.middle) == pytest.approx(disparity, rel=0.25, abs=0.02)


@pytest.mark.parametrize("width", [80, 24])
def test_strips_of_two_planes_span_a_range(width):
    near, far = smooth_views(0.5), smooth_views(-1.0)
    views = torch.where(torch.arange(160) // width % 2 == 0, near, far)
    seen = analyze_scene(views).ends
    assert seen.low < -0.7
    assert seen.high > 0.3


def test_disparities_are_per_step_wherever_cameras_stand():
    views, stand = smooth_views(0.5, (9, 9)), batches.even((9, 9))
    taken = (torch.tensor([0, 1, 4, 6, 8])[:, None], torch.tensor([0, 3, 4, 5, 8]))
    found = analyze_scene(views[taken], None, stand[taken] + 0.1).ends
    assert float(found.middle) == pytest.approx(0.5, rel=0.25)
    half_as_far = analyze_scene(views[taken], None, stand[taken] / 2).ends
    assert float(half_as_far.middle) == pytest.approx(2 * float(found.middle), rel=1e-4)
