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


def test_intervals_share_with_cells_what_lies_in_both():
    start, stop = torch.tensor([-0.5, 1.0]), torch.tensor([0.5, 9.0])
    assert cells.overlap(start, stop, torch.tensor([-1.0, 0, 2])).tolist() == [[0.5, 0.5], [0, 1]]
