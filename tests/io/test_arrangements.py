"""Numbers become rows and columns: the square is the only one that fits, with holes too."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import grid, view_folders

FOLDER = Path("f")


def found(numbers, name="{}.png"):
    (field,) = view_folders.following(
        [FOLDER / name.format(number) for number in numbers], [view_folders.compiled("index")]
    )
    return field


@pytest.mark.parametrize(("side", "first"), itertools.product(range(1, 18), (0, 1, 7)))
def test_all_numbers_of_a_square_make_it_from_wherever_they_begin(side, first):
    assert view_folders.square(first, first + side**2 - 1, side**2) == (side, first)


@pytest.mark.parametrize(("side", "base"), itertools.product((3, 5, 9, 17), (0, 1)))
def test_a_cross_and_a_diagonal_say_how_large_their_square_is(side, base):
    rows, columns = np.indices((side, side))
    middle = side // 2
    for shape in (
        (rows == middle) | (columns == middle),
        rows == columns,
        (rows == columns) & (rows % (side - 1) > 0) | (rows == middle),
    ):
        numbers = np.flatnonzero(shape) + base
        assert view_folders.square(int(numbers.min()), int(numbers.max()), len(numbers)) == (side, base)


@pytest.mark.parametrize("count", [2, 3, 5, 8, 15, 80])
def test_other_numbers_make_none(count):
    assert view_folders.square(0, count - 1, count) is None


def test_a_grid_that_is_asked_for_is_filled_row_by_row():
    arranged = view_folders.of(FOLDER, found(range(1, 7)), grid.Selection(grid=(2, 3)))
    assert arranged.shape == (2, 3)
    assert {cell: one.path.name for cell, one in arranged.cells.items()} == {
        divmod(index, 3): f"{index + 1}.png" for index in range(6)
    }
    assert arranged.name_of((1, 2)) == "6.png"


def test_numbers_that_leave_the_grid_asked_for_are_refused(one_line):
    with pytest.raises(InputError) as caught:
        view_folders.of(FOLDER, found(range(8)), grid.Selection(grid=(2, 3)))
    one_line(caught.value, FOLDER, "2x3", "8 views numbered 0 to 7", "reader.grid")


def test_a_number_that_is_no_square_names_the_first_that_is_missing(one_line):
    with pytest.raises(FileError) as caught:
        view_folders.of(FOLDER, found([0, 1, 2, 4, 5, 6, 7], "a{:03d}.png"), grid.Selection())
    one_line(caught.value, FOLDER, "a003.png", "reader.grid=[rows,columns]")
