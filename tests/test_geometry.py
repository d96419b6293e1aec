"""alpha <-> slope by hand, in both conventions; what no operator can use is refused."""

import json
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import CONVENTIONS, FocalPlanes, even_planes, planes_at_alphas, planes_from

PAPER = [index / 8 for index in range(1, 17)]


@pytest.mark.parametrize(
    ("convention", "slopes"), [("ng", [-7.0, -1.0, 0.0, 0.2, 0.5]), ("parallel", [-0.875, -0.5, 0.0, 0.25, 1.0])]
)
def test_slopes_by_hand(convention, slopes):
    values = geometry.slopes([0.125, 0.5, 1.0, 1.25, 2.0], convention)
    torch.testing.assert_close(values, torch.tensor(slopes, dtype=torch.float64), atol=1e-15, rtol=0)


def test_the_papers_planes_are_evenly_spaced_only_in_the_parallel_convention():
    parallel, ng = geometry.slopes(PAPER, "parallel").diff(), geometry.slopes(PAPER).diff()
    torch.testing.assert_close(parallel, torch.full_like(parallel, 0.125))
    assert bool((ng > 0).all())
    assert ng[0] == 4.0
    torch.testing.assert_close(ng[-1], torch.tensor(1 / 1.875 - 1 / 2, dtype=torch.float64))


@pytest.mark.parametrize("convention", list(CONVENTIONS))
@given(alpha=st.floats(1e-3, 1e3))
def test_alpha_comes_back_from_its_slope(convention, alpha):
    to_slope, to_alpha = CONVENTIONS[convention]
    # Near alpha = 1000 the slope is 0.999, and what it lacks to 1 has lost three digits.
    assert to_alpha(to_slope(alpha)) == pytest.approx(alpha, rel=1e-11)


@pytest.mark.parametrize("alphas", [[1.0, 0.0], [math.nan], [1e-320], [], "abc"], ids=str)
def test_what_is_no_list_of_alphas_is_refused(alphas):
    with pytest.raises(InputError):
        geometry.slopes(alphas)


@pytest.mark.parametrize("slopes", [[], [0.0, math.inf], "abc", None])
def test_what_are_no_slopes_is_refused(slopes):
    with pytest.raises(InputError):
        FocalPlanes(slopes)


def test_an_unknown_convention_is_refused():
    for function in (geometry.slopes, FocalPlanes):
        with pytest.raises(InputError):
            function([1.0], "Ng")


@pytest.mark.parametrize(
    ("arguments", "slopes"),
    [
        ((5,), [-1, -0.5, 0, 0.5, 1]),
        ((3, 1.0, -2.0), [1, -0.5, -2]),
        ((1, 0.5, 1.0), [0.75]),
    ],
)
def test_even_slopes_by_hand(arguments, slopes):
    values = geometry.even_slopes(*arguments)
    assert values.dtype == torch.float64
    assert values.tolist() == slopes


@pytest.mark.parametrize("arguments", [(0,), (4, math.nan), (4, -1.0, math.inf), (2.5,)])
def test_a_grid_of_no_planes_or_without_ends_is_refused(arguments):
    with pytest.raises(InputError):
        geometry.even_slopes(*arguments)


@pytest.mark.parametrize(("n_views", "offsets"), [(1, [0]), (2, [-0.5, 0.5]), (7, [-3, -2, -1, 0, 1, 2, 3])])
def test_views_are_counted_from_the_angular_centre(n_views, offsets):
    assert geometry.angular_offsets(n_views).tolist() == offsets


@pytest.mark.parametrize(
    ("slopes", "grid", "size", "fits"),
    [
        # 7 views at slope -7 shift by 21 pixels.
        ([0.5, -7.0], (7, 7), (42, 99), False),
        ([0.5, -7.0], (7, 7), (43, 43), True),
        ([3.0], (1, 7), (1, 19), True),
        ([1e6], (1, 1), (1, 1), True),
    ],
)
def test_a_corner_shift_of_half_the_view_is_refused(slopes, grid, size, fits):
    if fits:
        assert geometry.checked_slopes(slopes, grid, size).tolist() == slopes
    else:
        with pytest.raises(InputError):
            geometry.checked_slopes(slopes, grid, size)


def test_planes_are_slopes_whatever_they_were_written_as():
    planes = FocalPlanes(torch.tensor([-7.0, 0, 0.5], dtype=torch.float16, requires_grad=True))
    assert len(planes) == 3
    assert planes.slopes.tolist() == [-7.0, 0.0, 0.5]
    assert planes == planes_at_alphas([0.125, 1, 2])
    assert hash(planes) == hash(planes_at_alphas([0.125, 1, 2]))
    assert planes_at_alphas([0.5], "parallel") == FocalPlanes([-0.5])


def test_alphas_come_back_as_they_were_written():
    assert planes_at_alphas(PAPER).alphas == tuple(PAPER)
    assert planes_at_alphas(PAPER, "parallel").alphas == tuple(PAPER)
    assert planes_at_alphas([0.125, 2]).labels == ("alpha 0.125", "alpha 2")
    assert even_planes(2, -2, 0.5).labels == ("slope -2", "slope 0.5")


def test_titles_say_slope_and_alpha_as_far_as_alphas_reach():
    assert planes_at_alphas([0.125, 0.3]).titles == ("slope -7, alpha 0.125", "slope -2.333, alpha 0.3")
    assert FocalPlanes([-1, 0, 0.5, 1, 3]).titles == (
        "slope -1, alpha 0.5", "slope 0, alpha 1", "slope 0.5, alpha 2", "slope 1", "slope 3"
    )  # fmt: skip


def test_the_same_slopes_are_told_from_others():
    planes = planes_at_alphas([0.375, 1, 2])
    assert planes.has_slopes(planes.slopes.float())
    assert not planes.has_slopes([-5 / 3, 0.0])
    assert not planes.has_slopes([-5 / 3, 0.0, 0.501])


@pytest.mark.parametrize("planes", [planes_at_alphas(PAPER, "parallel"), even_planes(3, -2, 2)])
def test_planes_come_back_from_plain_containers(planes):
    again = planes_from(json.loads(json.dumps(planes.as_dict())))
    assert (again, again.convention) == (planes, planes.convention)


@pytest.mark.parametrize(("n_corners", "turn"), [(3, 0.0), (4, math.pi / 2), (5, 0.3), (8, 0.3)])
def test_a_disc_has_its_area_and_a_polygon_that_of_its_triangles(n_corners, turn):
    edges = torch.linspace(-4, 4, 9, dtype=torch.float64)
    assert float(geometry.covered_by_disc(edges, edges, 3.5)[4:, 4:].sum()) == pytest.approx(
        math.pi * 3.5**2 / 4, rel=1e-6
    )
    area = n_corners / 2 * 3.5**2 * math.sin(2 * math.pi / n_corners)
    assert float(geometry.covered_by_polygon(edges, edges, n_corners, 3.5, turn).sum()) == pytest.approx(area, rel=1e-6)
