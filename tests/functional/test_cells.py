"""Areas of cells that a disc covers: quarters, the whole, and a fine raster of points."""

import math

import pytest
import torch

from lfref.functional import cells


@pytest.mark.parametrize("radius", [1.0, 0.6, 3.5])
def test_four_cells_hold_a_quarter_each(radius):
    edges = torch.tensor([-4.0, 0, 4], dtype=torch.float64)
    quarter = torch.full((2, 2), math.pi * radius**2 / 4, dtype=torch.float64)
    torch.testing.assert_close(cells.of_disc(edges, edges, radius), quarter, rtol=1e-6, atol=0)


def test_areas_are_those_that_points_of_a_fine_raster_count():
    rows, columns = torch.tensor([-1.0, -0.3, 0.2, 1]).double(), torch.tensor([-1.0, 0.1, 0.9]).double()
    raster = (torch.arange(4000).double() + 0.5) / 2000 - 1
    inside = raster[:, None].square() + raster.square() < 1
    counted = [
        [float(inside[(top < raster) & (raster < end)][:, (left < raster) & (raster < right)].sum()) / 2000**2
         for left, right in columns.unfold(0, 2, 1).tolist()]
        for top, end in rows.unfold(0, 2, 1).tolist()
    ]  # fmt: skip
    torch.testing.assert_close(cells.of_disc(rows, columns), torch.tensor(counted).double(), atol=2e-4, rtol=0)


@pytest.mark.parametrize("n_corners", [3, 4, 5, 6, 8])
@pytest.mark.parametrize("turn", [0.0, 0.3, math.pi / 2])
def test_a_polygon_has_the_area_of_its_triangles(n_corners, turn):
    edges = torch.linspace(-4, 4, 9, dtype=torch.float64)
    area = n_corners / 2 * 3.5**2 * math.sin(2 * math.pi / n_corners)
    assert float(cells.of_polygon(edges, edges, n_corners, 3.5, turn).sum()) == pytest.approx(area, rel=1e-6)


def test_a_corner_points_where_the_polygon_is_turned_to():
    edges = torch.tensor([-1.0, 0, 1], dtype=torch.float64)
    left, right = cells.of_polygon(edges, edges, 3).sum(0)
    # The corner to the right has a third of the height of the triangle more than the side to the left.
    assert right < left
    upper, lower = cells.of_polygon(edges, edges, 3, turn=math.pi / 2).sum(1)
    torch.testing.assert_close(torch.stack([upper, lower]), torch.stack([left, right]), atol=1e-6, rtol=0)


def test_intervals_share_with_cells_what_lies_in_both():
    start, stop = torch.tensor([-0.5, 1.0]), torch.tensor([0.5, 9.0])
    assert cells.overlap(start, stop, torch.tensor([-1.0, 0, 2])).tolist() == [[0.5, 0.5], [0, 1]]
