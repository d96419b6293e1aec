"""Outlines cover the area that geometry says, with edges one pixel wide."""

import math

import pytest
import torch

from lfref.simulator.mattes import Disc, Leaf, Perforated, Polygon, Twigs

STEP = 0.25
AXIS = torch.arange(-60, 60, STEP, dtype=torch.float64)


def leaf_area(length, width):
    """Two segments of equal circles."""
    radius = (length**2 + width**2) / (4 * width)
    half_angle = math.asin(length / 2 / radius)
    return 2 * radius**2 * (half_angle - math.sin(half_angle) * math.cos(half_angle))


def twig_area(twig):
    ((x0, y0, x1, y1),) = twig.branches()
    return twig.width * math.hypot(x1 - x0, y1 - y0) + math.pi * twig.width**2 / 4


@pytest.mark.parametrize(
    ("outline", "expected"),
    [
        (Disc(20.3, (1.7, -4.2)), math.pi * 20.3**2),
        # The shoelace formula; edges that meet at a corner round it by less than a pixel.
        (Polygon(((-20.0, -10.0), (25.0, -14.0), (10.0, 30.0))), 0.5 * abs(45 * 40 - 30 * -4)),
        (Polygon(((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (0.0, 0.0), (-20.0, 20.0))), 1600 - 400),
        (Leaf(60.0, 22.0, 17.0), leaf_area(60.0, 22.0)),
        (twig := Twigs(40.0, 2.0, 0, 10.0, (-10.0, 3.0)), twig_area(twig)),
    ],
)
def test_an_outline_covers_its_area_and_nothing_outside_its_box(outline, expected):
    opacity = outline.opacity(AXIS, AXIS)
    assert float(opacity.sum()) * STEP**2 == pytest.approx(expected, rel=3e-3, abs=1)
    left, top, right, bottom = outline.box()
    rows, columns = AXIS[opacity.any(dim=1)], AXIS[opacity.any(dim=0)]
    assert top <= float(rows.min()) <= float(rows.max()) <= bottom
    assert left <= float(columns.min()) <= float(columns.max()) <= right


def test_a_perforated_sheet_leaves_out_a_disc_a_cell():
    axis = torch.arange(-40, 40, STEP, dtype=torch.float64)
    share = float(Perforated(20.0, 6.0).opacity(axis, axis).mean())
    assert share == pytest.approx(1 - math.pi * 36 / 400, abs=2e-3)


def test_an_edge_along_rows_or_columns_is_the_covered_part_of_a_pixel():
    half_plane = Polygon(((0.3, -500.0), (500.0, -500.0), (500.0, 500.0), (0.3, 500.0)))
    x = torch.arange(-3, 4, dtype=torch.float64)
    expected = (x + 0.5 - 0.3).clamp(0, 1).expand(3, -1)
    torch.testing.assert_close(half_plane.opacity(x, torch.arange(3.0, dtype=torch.float64)), expected)


def test_twigs_branch_in_two_and_come_from_their_seed():
    twigs = Twigs(20.0, 2.0, 4, seed=3)
    assert len(twigs.branches()) == 2**5 - 1
    starts = [segment[:2] for segment in twigs.branches()]
    ends = {segment[2:] for segment in twigs.branches()}
    assert all(start in ends for start in starts if start != (0.0, 0.0))
    assert twigs.branches() == Twigs(20.0, 2.0, 4, seed=3).branches()
    assert twigs.branches() != Twigs(20.0, 2.0, 4, seed=4).branches()
