"""Which views a window keeps, and what becomes of a grid with holes."""

from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import grid

PATH = Path("field")


@pytest.mark.parametrize(
    ("n_views", "count", "start", "first"),
    [
        (14, 7, None, 4),
        (14, 7, 3, 3),
        (14, 7, 7, 7),
        (9, 7, None, 1),
        (9, 9, None, 0),
        (14, 14, None, 0),
        (9, 1, None, 4),
    ],
)
def test_the_window_is_central_unless_it_is_told_its_start(n_views, count, start, first):
    rows, columns = grid.Selection((count, count), start).window((n_views, n_views), PATH)
    assert rows == columns == slice(first, first + count)


def test_no_number_of_views_keeps_all():
    assert grid.Selection().window((3, 5), PATH) == (slice(0, 3), slice(0, 5))


@pytest.mark.parametrize(("count", "start"), [(0, None), (-1, None), (8, None), (7, 1), (3, -1), (3, 5)])
def test_a_window_that_leaves_the_grid_is_refused(count, start, one_line):
    with pytest.raises(InputError) as caught:
        grid.Selection((count, count), start).window((7, 7), PATH)
    one_line(caught.value, PATH, "among the 7", f"views {count}", "reader.views and reader.start")


def test_a_hole_is_named_even_in_a_grid_of_billions(one_line):
    cells = {(0, 0): "a", (10**9, 10**9): "b"}
    with pytest.raises(FileError) as caught:
        grid.shape(cells, str, PATH)
    one_line(caught.value, PATH, "(0, 1)")


def test_only_the_views_of_the_window_are_loaded_and_each_once():
    cells = {(row, column): (row, column) for row in range(3) for column in range(4)}
    loaded = []

    def load(cell: tuple[int, int]) -> np.ndarray:
        loaded.append(cell)
        return np.full((2, 3, 1), 10 * cell[0] + cell[1], np.uint8)

    views = grid.gather(cells, (slice(1, 3), slice(2, 4)), load, str)
    assert loaded == [(1, 2), (1, 3), (2, 2), (2, 3)]
    assert views.shape == (2, 2, 1, 2, 3)
    assert views[:, :, 0, 0, 0].tolist() == [[12, 13], [22, 23]]


@pytest.mark.parametrize("odd", [np.zeros((2, 4, 1), np.uint8), np.zeros((2, 3, 3), np.uint8), np.zeros((2, 3, 1))])
def test_a_view_unlike_the_first_is_named(odd, one_line):
    cells = {(0, 0): "first", (0, 1): "odd"}
    with pytest.raises(FileError) as caught:
        grid.gather(
            cells, (slice(0, 1), slice(0, 2)), {"first": np.zeros((2, 3, 1), np.uint8), "odd": odd}.__getitem__, str
        )
    one_line(caught.value, "odd must be 2x3, 1 channels, uint8 as first", "alike")
