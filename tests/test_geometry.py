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


@given(alphas=st.lists(st.floats(1e-6, 1e6), min_size=2, unique=True))
def test_a_larger_alpha_never_has_a_smaller_slope(alphas):
    for convention in CONVENTIONS:
        values = geometry.slopes(sorted(alphas), convention)
        assert bool((values.diff() >= 0).all())


@pytest.mark.parametrize("alphas", [[1.0, 0.0], [-0.0], [-1.0], [math.nan], [math.inf], [1e-320], []], ids=str)
def test_an_alpha_that_is_no_distance_is_refused(alphas):
    with pytest.raises(InputError, match="alpha"):
        geometry.slopes(alphas)


def test_an_unknown_convention_is_refused_by_naming_the_known_ones():
    for function in (geometry.slopes, FocalPlanes):
        with pytest.raises(InputError, match="must be one of ng, parallel; got 'Ng'"):
            function([1.0], "Ng")


@pytest.mark.parametrize(
    ("arguments", "slopes"),
    [
        ((5,), [-1, -0.5, 0, 0.5, 1]),
        ((3, 0.5, 1.0), [0.5, 0.75, 1.0]),
        ((3, 1.0, -2.0), [1, -0.5, -2]),
        ((2, -7.0), [-7, 1]),
        ((1, 0.5, 1.0), [0.75]),
        ((2, 0.25, 0.25), [0.25, 0.25]),
    ],
)
def test_even_slopes_by_hand(arguments, slopes):
    values = geometry.even_slopes(*arguments)
    assert values.dtype == torch.float64
    assert values.tolist() == slopes


@pytest.mark.parametrize("arguments", [(0,), (-3,), (4, math.nan), (4, -1.0, math.inf)])
def test_a_grid_of_no_planes_or_without_ends_is_refused(arguments):
    with pytest.raises(InputError, match=rf"whole number of planes and finite ends; got {arguments[0]} planes"):
        geometry.even_slopes(*arguments)


@pytest.mark.parametrize(
    ("n_views", "offsets"), [(1, [0]), (2, [-0.5, 0.5]), (7, [-3, -2, -1, 0, 1, 2, 3]), (4, [-1.5, -0.5, 0.5, 1.5])]
)
def test_views_are_counted_from_the_angular_centre(n_views, offsets):
    assert geometry.angular_offsets(n_views).tolist() == offsets
    assert geometry.angular_offsets(n_views).dtype == torch.float64


def test_the_corner_shift_is_that_of_the_longer_axis_at_the_steepest_slope():
    assert geometry.corner_shift(torch.tensor([0.5, -7.0]), (7, 7)) == 21
    assert geometry.corner_shift(torch.tensor([0.5, -2.0]), (3, 8)) == 7
    assert geometry.corner_shift(torch.tensor([5.0]), (1, 1)) == 0


@pytest.mark.parametrize(("size", "axis"), [((42, 99), "height"), ((99, 42), "width"), ((42, 42), "height")])
def test_a_corner_shift_of_half_the_view_is_refused_by_naming_the_axis(size, axis):
    # 7 views at slope -7 shift by 21 pixels.
    with pytest.raises(InputError, match=rf"half the {axis} \(21 px\); got 21 px at slope -7"):
        geometry.checked_slopes([0.5, -7.0], (7, 7), size)


def test_a_corner_shift_just_below_half_the_view_is_accepted_along_either_axis():
    assert geometry.checked_slopes([0.5, -7.0], (7, 7), (43, 43)).tolist() == [0.5, -7.0]
    assert geometry.checked_slopes([3.0], (1, 7), (1, 19)).tolist() == [3.0]
    with pytest.raises(InputError, match="half the height"):
        geometry.checked_slopes([3.0], (7, 1), (18, 19))
    assert geometry.checked_slopes([1e6], (1, 1), (1, 1)).tolist() == [1e6]  # a single view never shifts


@pytest.mark.parametrize(
    "slopes", [0.5, [0.5], (0.5,), torch.tensor(0.5), torch.tensor([0.5], dtype=torch.float16, requires_grad=True)]
)
def test_slopes_of_any_kind_become_float64_on_the_cpu(slopes):
    values = geometry.checked_slopes(slopes, (3, 3), (8, 8))
    assert (values.dtype, values.device.type, values.requires_grad) == (torch.float64, "cpu", False)
    assert values.tolist() == [0.5]


def test_planes_are_slopes_whatever_they_were_written_as():
    planes = FocalPlanes((-7.0, 0, 0.5))
    assert len(planes) == 3
    assert planes.slopes.tolist() == [-7.0, 0.0, 0.5]
    assert planes == planes_at_alphas([0.125, 1, 2])
    assert hash(planes) == hash(planes_at_alphas([0.125, 1, 2]))
    assert planes_at_alphas([0.5], "parallel") == FocalPlanes([-0.5])


def test_alphas_come_back_as_they_were_written():
    assert planes_at_alphas(PAPER).alphas == tuple(PAPER)
    assert planes_at_alphas(PAPER, "parallel").alphas == tuple(PAPER)


def test_planes_are_called_what_they_were_written_as():
    assert planes_at_alphas([0.125, 2]).labels == ("alpha 0.125", "alpha 2")
    assert even_planes(2, -2, 0.5).labels == ("slope -2", "slope 0.5")


def test_titles_say_slope_and_alpha_as_far_as_alphas_reach():
    assert planes_at_alphas([0.125, 0.3]).titles == ("slope -7, alpha 0.125", "slope -2.333, alpha 0.3")
    assert FocalPlanes([-1, 0, 0.5, 1, 3]).titles == (
        "slope -1, alpha 0.5", "slope 0, alpha 1", "slope 0.5, alpha 2", "slope 1", "slope 3"
    )  # fmt: skip
    assert planes_at_alphas([0.25], "parallel").titles == ("slope -0.75, alpha 0.25",)
    assert FocalPlanes([-1.5], "parallel").titles == ("slope -1.5",)


def test_the_same_slopes_are_told_from_others():
    planes = planes_at_alphas([0.375, 1, 2])
    assert planes.has_slopes(planes.slopes.float())
    assert not planes.has_slopes([-5 / 3, 0.0])
    assert not planes.has_slopes([-5 / 3, 0.0, 0.501])


@pytest.mark.parametrize("planes", [planes_at_alphas(PAPER, "parallel"), even_planes(3, -2, 2)])
def test_planes_come_back_from_plain_containers(planes):
    again = planes_from(json.loads(json.dumps(planes.as_dict())))
    assert (again, again.convention) == (planes, planes.convention)


@pytest.mark.parametrize("plain", [{}, {"slopes": []}, {"alphas": [-1.0]}, {"slopes": [0.5], "convention": "Ng"}])
def test_containers_that_describe_no_planes_are_refused(plain):
    with pytest.raises(InputError):
        planes_from(plain)


@pytest.mark.parametrize("slopes", [[], [math.nan], [0.0, math.inf], "abc", ["x"], None])
def test_planes_refuse_what_are_no_slopes(slopes):
    with pytest.raises(InputError, match="slopes must be"):
        FocalPlanes(slopes)


@pytest.mark.parametrize("radius", [1.0, 0.6, 3.5])
def test_four_cells_hold_a_quarter_each(radius):
    edges = torch.tensor([-4.0, 0, 4], dtype=torch.float64)
    quarter = torch.full((2, 2), math.pi * radius**2 / 4, dtype=torch.float64)
    torch.testing.assert_close(geometry.covered_by_disc(edges, edges, radius), quarter, rtol=1e-6, atol=0)


def test_areas_are_those_that_points_of_a_fine_raster_count():
    rows, columns = torch.tensor([-1.0, -0.3, 0.2, 1]).double(), torch.tensor([-1.0, 0.1, 0.9]).double()
    raster = (torch.arange(4000).double() + 0.5) / 2000 - 1
    inside = raster[:, None].square() + raster.square() < 1
    counted = [
        [float(inside[(top < raster) & (raster < end)][:, (left < raster) & (raster < right)].sum()) / 2000**2
         for left, right in columns.unfold(0, 2, 1).tolist()]
        for top, end in rows.unfold(0, 2, 1).tolist()
    ]  # fmt: skip
    torch.testing.assert_close(
        geometry.covered_by_disc(rows, columns), torch.tensor(counted).double(), atol=2e-4, rtol=0
    )


@pytest.mark.parametrize("n_corners", [3, 4, 5, 6, 8])
@pytest.mark.parametrize("turn", [0.0, 0.3, math.pi / 2])
def test_a_polygon_has_the_area_of_its_triangles(n_corners, turn):
    edges = torch.linspace(-4, 4, 9, dtype=torch.float64)
    area = n_corners / 2 * 3.5**2 * math.sin(2 * math.pi / n_corners)
    assert float(geometry.covered_by_polygon(edges, edges, n_corners, 3.5, turn).sum()) == pytest.approx(area, rel=1e-6)


def test_a_corner_points_where_the_polygon_is_turned_to():
    edges = torch.tensor([-1.0, 0, 1], dtype=torch.float64)
    left, right = geometry.covered_by_polygon(edges, edges, 3).sum(0)
    # The corner to the right has a third of the height of the triangle more than the side to the left.
    assert right < left
    upper, lower = geometry.covered_by_polygon(edges, edges, 3, turn=math.pi / 2).sum(1)
    torch.testing.assert_close(torch.stack([upper, lower]), torch.stack([left, right]), atol=1e-6, rtol=0)


def test_intervals_share_with_cells_what_lies_in_both():
    start, stop = torch.tensor([-0.5, 1.0]), torch.tensor([0.5, 9.0])
    assert geometry.overlap(start, stop, torch.tensor([-1.0, 0, 2])).tolist() == [[0.5, 0.5], [0, 1]]
