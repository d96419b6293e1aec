"""Reduced views: which are looked at, what is trusted of them, and brightness evened out where it is no parallax."""

import pytest
import torch

from lfref.refocus.focus.slope_range import reduce_views
from tests.refocus.conftest import shifted_views, texture


@pytest.mark.parametrize(
    ("grid", "reference", "count"),
    [((7, 7), (3, 3), 13), ((14, 14), (7, 7), 13), ((9, 9), (4, 4), 13), ((1, 5), (0, 2), 5), ((1, 1), (0, 0), 1)],
)
def test_views_lie_on_a_cross_through_the_centre(grid, reference, count):
    seen = reduce_views(torch.rand(*grid, 3, 32, 40))
    assert seen.indices[0] == reference
    assert len(set(seen.indices)) == count
    assert all(v == reference[0] or u == reference[1] for v, u in seen.indices)
    assert seen.steps.tolist() == [[v - reference[0], u - reference[1]] for v, u in seen.indices]


def test_where_the_cross_is_missing_diagonals_are_looked_at():
    weight = torch.eye(5)[:, :, None, None, None].expand(5, 5, 1, 32, 40)
    assert set(reduce_views(torch.rand(5, 5, 3, 32, 40), weight).indices) == {(k, k) for k in range(5)}


def test_pictures_are_roots_of_mean_light():
    views = torch.rand(3, 3, 3, 200, 300, dtype=torch.float64)
    seen = reduce_views(views, pixels=600)
    assert seen.factor == 10
    block = views[1, 1, :, 30:40, 50:60].mean()
    assert float(seen.pictures[0, 3, 5]) == pytest.approx(float(block.sqrt()), rel=1e-5)


def test_smooth_gains_are_taken_out_and_parallax_is_left():
    views = shifted_views(texture(1, 96, 120), 0.5, (5, 5)) + 0.2
    gain = 1 - 0.3 * torch.linspace(-1, 1, 120).square() * torch.arange(-2, 3)[:, None, None, None].square() / 4
    plain, evened = reduce_views(views), reduce_views(views * gain)
    torch.testing.assert_close(evened.pictures, plain.pictures, rtol=0.02, atol=0.01)
    # Without shading, nothing is touched.
    grey = views.mean(2).float().clamp(min=0).sqrt()
    for picture, (v, u) in zip(plain.pictures, plain.indices, strict=True):
        torch.testing.assert_close(picture, grey[v, u], rtol=1e-5, atol=1e-6)


def test_black_corners_and_what_is_dark_inside_are_told_apart():
    views = torch.full((5, 5, 1, 60, 80), 0.5)
    y, x = torch.meshgrid(torch.arange(60.0) - 29.5, torch.arange(80.0) - 39.5, indexing="ij")
    views[..., (y.square() + x.square()).sqrt() > 42] = 0
    views[..., 25:35, 35:45] = 0
    weights = reduce_views(views).weights
    assert weights[:, 0, 0].sum() == weights[:, -1, -1].sum() == 0
    assert bool((weights[:, 20:40, 30:50] == 1).all())


def test_rows_and_columns_can_be_looked_at_alone():
    seen = reduce_views(torch.rand(5, 7, 3, 32, 40))
    assert sorted(seen.along(1).indices) == [(2, u) for u in range(7)]
    assert sorted(seen.along(0).indices) == [(v, 3) for v in range(5)]
