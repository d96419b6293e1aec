"""Outlines cover the area that geometry says, with edges one pixel wide."""

import math

import pytest
import torch

from lfref.errors import InputError
from lfref.simulator.mattes import Disc, Full, Leaf, Perforated, Polygon, Twigs

STEP = 0.25
AXIS = torch.arange(-60, 60, STEP, dtype=torch.float64)
OUTLINES = [
    Disc(20.0, (3.0, -5.0)),
    Polygon(((-20.0, -10.0), (25.0, -14.0), (10.0, 30.0))),
    Leaf(60.0, 22.0, 30.0, (2.0, 1.0)),
    Leaf(60.0, 1.0),
    Twigs(20.0, 3.0, 3, -90.0, (0.0, 25.0), 4),
]


def area(outline):
    return float(outline.opacity(AXIS, AXIS).sum()) * STEP**2


def test_a_disc_covers_its_area():
    assert area(Disc(20.3, (1.7, -4.2))) == pytest.approx(math.pi * 20.3**2, rel=1e-3)


def test_a_polygon_covers_its_area():
    # The shoelace formula; edges that meet at a corner round it by less than a pixel.
    assert area(OUTLINES[1]) == pytest.approx(0.5 * abs(45 * 40 - 30 * -4), abs=1)
    concave = Polygon(((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (0.0, 0.0), (-20.0, 20.0)))
    assert area(concave) == pytest.approx(1600 - 400, abs=1)


def test_a_leaf_covers_two_segments_of_its_circles():
    length, width = 60.0, 22.0
    radius = (length**2 + width**2) / (4 * width)
    half_angle = math.asin(length / 2 / radius)
    segment = radius**2 * (half_angle - math.sin(half_angle) * math.cos(half_angle))
    assert area(Leaf(length, width, 17.0)) == pytest.approx(2 * segment, rel=3e-3)


def test_a_straight_twig_covers_length_times_width_and_its_round_ends():
    twig = Twigs(40.0, 2.0, 0, 10.0, (-10.0, 3.0))
    ((x0, y0, x1, y1),) = twig.branches()
    assert area(twig) == pytest.approx(2.0 * math.hypot(x1 - x0, y1 - y0) + math.pi, rel=0.02)


def test_a_perforated_sheet_leaves_out_a_disc_a_cell():
    axis = torch.arange(-40, 40, STEP, dtype=torch.float64)
    share = float(Perforated(20.0, 6.0).opacity(axis, axis).mean())
    assert share == pytest.approx(1 - math.pi * 36 / 400, abs=2e-3)


def test_an_edge_along_rows_or_columns_is_the_covered_part_of_a_pixel():
    half_plane = Polygon(((0.3, -500.0), (500.0, -500.0), (500.0, 500.0), (0.3, 500.0)))
    x = torch.arange(-3, 4, dtype=torch.float64)
    expected = (x + 0.5 - 0.3).clamp(0, 1).expand(3, -1)
    torch.testing.assert_close(half_plane.opacity(x, torch.arange(3.0, dtype=torch.float64)), expected)


def test_a_disc_falls_from_one_to_zero_over_a_pixel_along_any_radius():
    angles = torch.linspace(0, 6, 7, dtype=torch.float64)
    for reach, expected in ((9.5, 1.0), (9.75, 0.75), (10.0, 0.5), (10.5, 0.0)):
        edge = Disc(10.0).opacity(reach * angles.cos(), reach * angles.sin()).diagonal()
        torch.testing.assert_close(edge, torch.full((7,), expected, dtype=torch.float64))


@pytest.mark.parametrize("outline", OUTLINES)
def test_nothing_is_outside_the_box(outline):
    left, top, right, bottom = outline.box()
    opacity = outline.opacity(AXIS, AXIS)
    rows, columns = opacity.any(dim=1), opacity.any(dim=0)
    assert top <= float(AXIS[rows].min())
    assert float(AXIS[rows].max()) <= bottom
    assert left <= float(AXIS[columns].min())
    assert float(AXIS[columns].max()) <= right


def test_endless_outlines_have_no_box_and_full_is_one_everywhere():
    assert Full().box() is Perforated(20.0, 6.0).box() is None
    assert torch.equal(Full().opacity(AXIS, AXIS[:3]), torch.ones(3, len(AXIS), dtype=torch.float64))


def test_twigs_branch_in_two_and_come_from_their_seed():
    twigs = Twigs(20.0, 2.0, 4, seed=3)
    assert len(twigs.branches()) == 2**5 - 1
    starts = [segment[:2] for segment in twigs.branches()]
    ends = {segment[2:] for segment in twigs.branches()}
    assert all(start in ends for start in starts if start != (0.0, 0.0))
    assert twigs.branches() == Twigs(20.0, 2.0, 4, seed=3).branches()
    assert twigs.branches() != Twigs(20.0, 2.0, 4, seed=4).branches()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Disc(0.1), lambda: Disc(3.0, (0.0,)), lambda: Polygon(((0.0, 0.0), (1.0, 1.0))),
        lambda: Polygon(((0.0, 0.0), (1.0, 1.0), (math.nan, 0.0))), lambda: Leaf(5.0, 5.0), lambda: Leaf(5.0, 0.0),
        lambda: Twigs(10.0, 0.5), lambda: Twigs(10.0, generations=9), lambda: Perforated(10.0, 5.0),
    ],
)  # fmt: skip
def test_outlines_that_are_none_are_refused(make):
    with pytest.raises(InputError):
        make()
