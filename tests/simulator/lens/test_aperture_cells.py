"""Cells of an aperture: they cover it, their shares add up, and their number follows what moves."""

import math

import pytest
import torch

from lfref.simulator import scenery
from lfref.simulator.scene import Camera
from lfref.simulator.scenery import Aperture


@pytest.mark.parametrize("shape", ["square", "disc"])
@pytest.mark.parametrize("n_cells", [1, 4, 7])
def test_shares_add_up_to_one_and_balance_about_the_centre(shape, n_cells):
    cells = scenery.cut(Aperture(shape, 5.0, 7.0), n_cells)
    assert float(cells.weights.sum()) == pytest.approx(1)
    torch.testing.assert_close(cells.weights, cells.weights.flip(0, 1))
    assert float(cells.p.mean()) == pytest.approx(0, abs=1e-12)
    assert cells.weights.shape == (len(cells.q), len(cells.p))


def test_cells_of_a_square_are_alike_and_fill_it():
    cells = scenery.cut(Aperture("square", 3.0, 6.0), 4)
    assert (len(cells.q), len(cells.p)) == (2, 4)
    assert (cells.height, cells.width) == (1.5, 1.5)
    torch.testing.assert_close(cells.p, torch.tensor([-2.25, -0.75, 0.75, 2.25], dtype=torch.float64))
    torch.testing.assert_close(cells.weights, torch.full((2, 4), 1 / 8, dtype=torch.float64))


def test_shares_of_a_disc_are_those_of_fine_samples():
    fine = (torch.arange(1000, dtype=torch.float64) + 0.5) / 500 - 1
    inside = (fine[:, None].square() + fine.square() <= 1).double()
    expected = torch.nn.functional.avg_pool2d(inside[None], 200)[0]
    cells = scenery.cut(Aperture("disc", 7.0, 7.0), 5)
    torch.testing.assert_close(cells.weights, expected / expected.sum(), atol=1e-4, rtol=0)


def test_an_aperture_spans_the_cells_of_the_views():
    whole = scenery.aperture(Camera(grid=(5, 9), aperture="disc"))
    assert whole == Aperture("disc", 5.0, 9.0)


def test_a_pinhole_has_one_cell_in_the_middle():
    cells = scenery.cut(Aperture("disc", 0.0, 0.0), 3)
    assert (cells.p.tolist(), cells.q.tolist(), cells.weights.tolist()) == ([0], [0], [[1]])


def test_what_moves_while_others_stand_still_needs_one_cell():
    assert scenery.needed(Aperture("square", 7, 7), [0.0, 7.5, 0.0]) == 1
    assert scenery.needed(Aperture("square", 7, 7), []) == 1
    assert scenery.needed(Aperture("disc", 7, 7), [0.0]) == 1


def test_a_surface_alone_gets_the_cells_of_two():
    for shape in ("square", "disc"):
        whole = Aperture(shape, 7, 7)
        assert scenery.needed(whole, [7.5]) == scenery.needed(whole, [7.5, 7.5]) > 1


def test_cells_grow_with_the_second_fastest_and_on_a_disc_with_the_fastest():
    speeds = [0.0, 1.0, 4.0]
    assert scenery.needed(Aperture("square", 7, 7), speeds) == 1 + math.ceil(1.2 * math.sqrt(7))
    assert scenery.needed(Aperture("disc", 7, 7), speeds) == 1 + math.ceil(2 * math.sqrt(28))
