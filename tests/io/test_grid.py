"""Which views a window keeps, and what becomes of a grid with holes."""

from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import grid

PATH = Path("field")


def test_a_hole_is_named_even_in_a_grid_of_billions(one_line):
    cells = {(0, 0): "a", (10**9, 10**9): "b"}
    with pytest.raises(FileError) as caught:
        grid.check_holes(grid.Grid(grid.extent(cells), cells), str, PATH, allowed=True)
    one_line(caught.value, PATH, "(0, 1)")


def test_only_the_views_of_the_window_are_loaded_and_each_once():
    cells = {(row, column): (row, column) for row in range(3) for column in range(4)}
    loaded = []

    def load(cell: tuple[int, int]) -> np.ndarray:
        loaded.append(cell)
        return np.full((2, 3, 1), 10 * cell[0] + cell[1], np.uint8)

    views = grid.gather(grid.Grid((3, 4), cells), (slice(1, 3), slice(2, 4)), load, str)
    assert loaded == [(1, 2), (1, 3), (2, 2), (2, 3)]
    assert views.shape == (2, 2, 1, 2, 3)
    assert views[:, :, 0, 0, 0].tolist() == [[12, 13], [22, 23]]


@pytest.mark.parametrize("odd", [np.zeros((2, 4, 1), np.uint8), np.zeros((2, 3, 3), np.uint8), np.zeros((2, 3, 1))])
def test_a_view_unlike_the_first_is_named(odd, one_line):
    cells = {(0, 0): "first", (0, 1): "odd"}
    load = {"first": np.zeros((2, 3, 1), np.uint8), "odd": odd}.__getitem__
    with pytest.raises(FileError) as caught:
        grid.gather(grid.Grid((1, 2), cells), (slice(0, 1), slice(0, 2)), load, str)
    one_line(caught.value, "odd must be 2x3, 1 channels, uint8 as first", "alike")


def layout(*rows: str) -> grid.Grid:
    """A grid whose views are the crosses of a drawing."""
    cells = {(row, column): 0 for row, line in enumerate(rows) for column, mark in enumerate(line) if mark == "x"}
    return grid.Grid((len(rows), len(rows[0])), cells)


ON_PURPOSE = {
    "cross": layout("..x..", "..x..", "xxxxx", "..x..", "..x.."),
    "diagonal": layout("x...", ".x..", "..x.", "...x"),
    "both diagonals": layout("x...x", ".x.x.", "..x..", ".x.x.", "x...x"),
    "no corners": layout(".xxx.", "xxxxx", "xxxxx", "xxxxx", ".xxx."),
}
BY_ACCIDENT = {
    "one missing": layout("xxx", "xxx", "x.x"),
    "the middle missing": layout("xxx", "x.x", "xxx"),
    "the last missing": layout("xxxx", "xxxx", "xxxx", "...."[:3] + "x"),
    "a copy cut short": layout("xxxxx", "xxxxx", "xxxxx", "xx...", "....x"),
}


@pytest.mark.parametrize("stored", ON_PURPOSE.values(), ids=ON_PURPOSE)
def test_holes_that_look_the_same_upside_down_are_on_purpose(stored):
    grid.check_holes(stored, str, PATH)
    with pytest.raises(FileError):
        grid.check_holes(stored, str, PATH, allowed=False)


@pytest.mark.parametrize("stored", BY_ACCIDENT.values(), ids=BY_ACCIDENT)
def test_other_holes_must_be_allowed(stored, one_line):
    grid.check_holes(stored, str, PATH, allowed=True)
    with pytest.raises(FileError) as caught:
        grid.check_holes(stored, str, PATH)
    one_line(caught.value, PATH, "missing)", "reader.holes=true")


@pytest.mark.parametrize(("channels", "kind"), [(1, np.uint8), (3, np.uint16), (3, np.float32), (4, np.uint8)])
def test_holes_have_weight_zero_and_the_mean_of_the_other_views(channels, kind):
    full = 1 if kind is np.float32 else np.iinfo(kind).max
    stored = {
        cell: np.full((2, 3, channels), (cell[0] + cell[1] + 1) / 4 * full).astype(kind) for cell in [(0, 0), (1, 1)]
    }
    views = grid.gather(grid.Grid((2, 2), {cell: cell for cell in stored}), (slice(0, 2), slice(0, 2)), stored.get, str)
    n_colours = channels - 1 + channels % 2
    assert (views.shape, views.dtype) == ((2, 2, n_colours + 1, 2, 3), kind)
    expected = np.mean([view[..., :n_colours] for view in stored.values()])
    for hole in ((0, 1), (1, 0)):
        np.testing.assert_allclose(views[hole][:-1], expected, atol=0.5 if kind is not np.float32 else 1e-6)
        assert not views[hole][-1].any()
    for cell, view in stored.items():
        np.testing.assert_array_equal(views[cell][:n_colours], view[..., :n_colours].transpose(2, 0, 1))
        assert (views[cell][-1] == (view[..., -1] if channels == 4 else full)).all()


def test_a_window_of_nothing_but_holes_is_refused(one_line):
    with pytest.raises(FileError) as caught:
        grid.gather(grid.Grid((2, 2), {(0, 0): 0}), (slice(1, 2), slice(1, 2)), lambda cell: np.zeros((1, 1, 1)), str)
    one_line(caught.value, "none", "reader.views")
