"""What is found out about planes: against sums written out, and simple scenes."""

from dataclasses import replace

import pytest
import torch

from lfref.functional.psnr import psnr
from lfref.lightfield import LightField
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocuser.features import CELLS, GUIDES, LEAST, Seen, guides
from lfref.refocuser.operators import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.noise import noisy
from lfref.simulator.scene import Camera
from lfref.simulator.simulate import simulate

from .cases import BASE, SLOPES, seen

INNER = (..., slice(24, -24), slice(24, -24))


def test_views_agree_where_a_plane_is_in_focus_and_differ_elsewhere():
    inner = (..., slice(8, -8), slice(8, -8))
    spread = seen().spread[inner].mean((1, 2, 3))
    assert float(spread[1]) < 0.01
    assert float(spread[0]) > 0.04
    assert float(spread[2]) > 0.04


def test_the_spread_is_that_of_the_views_where_nothing_moves():
    views = torch.rand(3, 3, 3, 12, 14)
    still = Seen(LightField(views), torch.zeros(1, dtype=torch.float64), BASE)
    expected = views.mean(2).flatten(0, 1).std(0, correction=0)
    torch.testing.assert_close(still.spread[0, 0], expected, atol=1e-5, rtol=1e-4)


def test_defocus_is_the_slope_less_the_disparity():
    found = seen().defocus[:, 0, 10:-10, 10:-10]
    for plane, slope in zip(found, SLOPES.tolist(), strict=True):
        assert float((plane - (slope - 0.4)).abs().median()) < 0.02


def test_relief_is_how_much_disparities_vary_within_a_square():
    light = seen()
    for found, reach in zip(light.relief[0], (4, 16), strict=True):
        around = light.disparities[max(0, 12 - reach) : 12 + reach + 1, 20 - reach : 20 + reach + 1]
        assert float(found[12, 20]) == pytest.approx(float(around.max() - around.min()))


def test_coverage_counts_the_views_that_see_a_pixel_within_their_frame():
    light = Seen(LightField(torch.rand(3, 5, 3, 9, 12)), SLOPES, BASE)
    expected = torch.zeros(3, 1, 9, 12)
    for plane, slope in enumerate(SLOPES.tolist()):
        for row, column in torch.cartesian_prod(torch.arange(9), torch.arange(12)).tolist():
            reads = [(row + slope * (v - 1), column + slope * (u - 2)) for v in range(3) for u in range(5)]
            inside = [-1 < y < 9 and -1 < x < 12 for y, x in reads]
            expected[plane, 0, row, column] = sum(inside) / 15
    torch.testing.assert_close(light.coverage, expected)


def test_the_middle_of_the_aperture_is_the_mean_of_its_views():
    views = torch.rand(5, 5, 3, 12, 14)
    still = Seen(LightField(views), torch.zeros(1, dtype=torch.float64), BASE)
    weights = torch.tensor([0.0, 0.75, 1.0, 0.75, 0.0])
    weights = weights[:, None] * weights / weights.sum() ** 2
    grey = views.mean(2)
    expected = torch.einsum("vu,vuhw->hw", weights, grey) - grey.mean((0, 1))
    torch.testing.assert_close(still.inner[0, 0], expected, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("rows", [slice(1, None, 2), slice(0, None, 2)], ids=["five rows", "six rows"])
@pytest.mark.parametrize("columns", [slice(1, None, 2), slice(0, None, 2)], ids=["five columns", "six columns"])
def test_the_view_in_the_middle_is_seen_from_there_whether_one_stands_there_or_not(rows, columns):
    # Every second of eleven views are five with one in the middle, or six with none.
    dense = simulate(
        replace(sim30.SCENES["dome"], camera=Camera(grid=(11, 11), size=(72, 80))), outputs=("views",)
    ).views
    found = Seen(LightField(dense[rows, columns].contiguous()), SLOPES, BASE)
    inner = (..., slice(8, -8), slice(8, -8))
    assert float(psnr(found.central[inner], dense[5, 5][inner])) > 40


def test_samples_that_are_not_trusted_are_not_looked_at():
    whole = seen()
    weight = torch.ones(5, 5, 1, 40, 48)
    weight[2, 2, :, 10:20, 10:20] = 0
    spoilt = torch.where(weight > 0, whole.light.views, 0.0)
    mended = Seen(LightField(spoilt, weight=weight), SLOPES, BASE)
    assert float((mended.central - whole.central).abs().max()) < 0.3
    assert float((mended.disparities - whole.disparities).abs().mean()) < 0.02


def test_the_doubt_is_how_far_the_nearer_of_two_others_is_around_a_pixel_and_noise():
    light = seen()
    apart = torch.minimum((light.sums - light.pictures).abs(), (light.cells - light.pictures).abs()).mean(1)
    row, column = 20, 24
    for plane in range(2):
        around = apart[plane, row - 2 : row + 3, column - 2 : column + 3].mean()
        expected = around.hypot(light.chance[plane, 0, row, column])
        torch.testing.assert_close(light.doubt[plane, 0, row, column], expected)


def test_chance_is_the_noise_that_the_mean_of_the_views_keeps():
    views = noisy(torch.full((5, 5, 3, 160, 160), 0.4), 1e-3, 1e-4, torch.randn(5, 5, 3, 160, 160))
    still = Seen(LightField(views), torch.zeros(1, dtype=torch.float64), BASE)
    kept = float(still.pictures.std())
    assert float(still.chance.mean()) == pytest.approx(kept, rel=0.1)
    five = Seen(still.light, still.slopes, BASE.through(lambda grid: torch.eye(5)))
    assert float(five.chance.mean()) == pytest.approx(float(five.pictures.std()), rel=0.2)


def test_views_without_noise_leave_nothing_to_chance():
    assert float(seen().chance.max()) < 1e-3


def test_smoother_pictures_are_binomial_filters_of_each_other():
    light = seen()
    kernel = torch.tensor([0.25, 0.5, 0.25])
    before = light.pictures
    for apart, found in zip((1, 2, 4), light.smoother, strict=True):
        filled = torch.zeros(2 * apart + 1)
        filled[::apart] = kernel
        padded = torch.nn.functional.pad(before, (apart,) * 4, mode="replicate")
        expected = torch.nn.functional.conv2d(padded, (filled[:, None] * filled).expand(3, 1, -1, -1), groups=3)
        torch.testing.assert_close(found, expected)
        before = found


def test_offers_are_differences_in_doubts_and_never_many():
    light = seen()
    found = light.offered(light.pictures + 0.1 * light.doubt)[(light.doubt > 1e-3).expand(-1, 3, -1, -1)]
    torch.testing.assert_close(found, torch.full_like(found, 0.1 / (1 + 0.1 / 3)), rtol=0.01, atol=0)
    assert len(found) > 1000
    assert float(light.offered(light.pictures + 1e3).max()) <= 3


def test_differences_in_doubts_are_pressed_as_the_area_hyperbolic_sine_does():
    light = seen()
    times = torch.tensor([-1e4, -2.0, -1e-3, 0.0, 1e-3, 2.0, 1e4]).reshape(-1, 1, 1, 1, 1)
    found = light.of_doubt(times * (light.doubt + LEAST))
    torch.testing.assert_close(found, times.asinh().expand_as(found), atol=1e-6, rtol=1e-5)


def test_there_is_a_doubt_only_where_all_views_see():
    light = seen()
    assert bool((light.doubt[light.coverage < 1] == 0).all())
    assert float((light.doubt > 0).float().mean()) > 0.5


def test_one_view_has_no_disparity():
    light = LightField(torch.rand(1, 1, 3, 12, 14))
    assert torch.equal(Seen(light, SLOPES, BASE).disparities, torch.zeros(12, 14))


def test_the_classical_pictures_are_as_good_as_the_method_makes_them_alone():
    scene = sim30.SCENES["lattice"]
    slopes = torch.tensor([-0.33, 0.2], dtype=torch.float64)
    made = simulate(scene, outputs=("views", "truth"), slopes=slopes)
    base = OperatorRefocuser("occlusion_aware", occlusion_aware)
    pictures, alone = Seen(LightField(made.views), slopes, base).pictures, base(made.views, slopes)
    before, after = (psnr(each[INNER], made.truth[INNER]) for each in (alone, pictures))
    assert float((after - before).min()) > -0.1


def test_disparities_are_not_looked_for_where_they_are_of_no_use(monkeypatch):
    monkeypatch.setattr("lfref.refocuser.features.coarse_disparity", None)
    light = Seen(LightField(torch.rand(3, 3, 3, 24, 26)), SLOPES, CELLS)
    for part in light.parts(2):
        assert bool(guides(part, ["sum", "spread", "doubt", "chance"]).isfinite().all())


@pytest.mark.parametrize("n_planes", [1, 2, 3, 5])
def test_parts_know_what_the_whole_knows(n_planes):
    whole = seen()
    parts = list(seen().parts(n_planes))
    assert [len(part.slopes) for part in parts] == [len(each) for each in SLOPES.split(n_planes)]
    torch.testing.assert_close(torch.cat([guides(part, GUIDES) for part in parts]), guides(whole, GUIDES))


def test_pictures_that_are_one_of_the_sums_themselves_are_measured_by_the_other():
    light = Seen(seen().light, SLOPES, CELLS)
    assert light.is_one == (False, True)
    apart = (light.sums - light.pictures).abs().mean(1)[2, 18:23, 22:27].mean()
    torch.testing.assert_close(light.doubt[2, 0, 20, 24], apart.hypot(light.chance[2, 0, 20, 24]))
    assert float(apart) > 1e-4
