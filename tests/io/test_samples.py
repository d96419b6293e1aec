"""Options of the reader, windows of views, and grids with holes."""

import inspect
import math
from pathlib import Path

import pytest

from lfref.errors import FileError, InputError
from lfref.io import lenslets, read, samples
from lfref.io.samples import ReadOptions

PATH = Path("field")


def test_every_option_of_the_reader_has_its_default():
    parameters = dict(inspect.signature(read.read).parameters)
    del parameters["path"]
    assert ReadOptions.parse(**{name: one.default for name, one in parameters.items()}) == ReadOptions()


@pytest.mark.parametrize(
    ("n_views", "count", "start", "first"),
    [(14, 7, None, 4), (14, 7, 3, 3), (9, 7, None, 1), (9, 1, None, 4)],
)
def test_the_window_is_central_unless_it_has_a_start(n_views, count, start, first):
    rows, columns = ReadOptions((count, count), start).window((n_views, n_views), PATH)
    assert rows == columns == slice(first, first + count)


@pytest.mark.parametrize(("count", "start"), [(0, None), (8, None), (3, -1), (3, 5)])
def test_a_window_that_leaves_the_grid_is_refused(count, start):
    with pytest.raises(InputError):
        ReadOptions((count, count), start).window((7, 7), PATH)


def lattice(**given):
    return lenslets.overridden(None, ReadOptions.parse(**given))


def test_one_pitch_is_that_of_neighbours():
    assert lattice(pitch=14.29).pitch == pytest.approx((14.29, 14.29))
    hexagonal = lattice(pitch=14.29, lattice="hexagonal")
    assert hexagonal.pitch == pytest.approx((14.29 * math.sqrt(3) / 2, 14.29))
    assert hexagonal.is_hexagonal
    assert lattice(pitch=[12, 15]).pitch == pytest.approx((12, 15))


@pytest.mark.parametrize(
    "wrong",
    [
        {"size": 5}, {"lenslet": "a"}, {"pitch": 1}, {"pitch": 1.7, "lattice": "hexagonal"}, {"pitch": math.nan},
        {"pitch": 14, "offset": 3}, {"pitch": 14, "rotation": 46}, {"rotation": 1}, {"lattice": "round"},
        {"spacing": [0, 1]},
    ],
)  # fmt: skip
def test_impossible_options_are_refused(wrong):
    with pytest.raises(InputError):
        lattice(**wrong)


def cells_of(drawing: str) -> dict[tuple[int, int], int]:
    """A grid whose views are the crosses of a drawing."""
    rows = drawing.split()
    return {(row, column): 0 for row, line in enumerate(rows) for column, mark in enumerate(line) if mark == "x"}


ON_PURPOSE = {
    "cross": "..x.. ..x.. xxxxx ..x.. ..x..", "diagonal": "x... .x.. ..x. ...x",
    "no corners": ".xxx. xxxxx xxxxx xxxxx .xxx.",
}  # fmt: skip
BY_ACCIDENT = {
    "the middle missing": "xxx x.x xxx", "a copy cut short": "xxxxx xxxxx xxxxx xx... ....x",
}  # fmt: skip


@pytest.mark.parametrize("drawing", ON_PURPOSE.values(), ids=ON_PURPOSE)
def test_holes_that_look_the_same_upside_down_are_on_purpose(drawing):
    cells = cells_of(drawing)
    samples.check_holes(cells, samples.extent(cells), PATH, None)
    with pytest.raises(FileError):
        samples.check_holes(cells, samples.extent(cells), PATH, False)


@pytest.mark.parametrize("drawing", BY_ACCIDENT.values(), ids=BY_ACCIDENT)
def test_other_holes_must_be_allowed(drawing):
    cells = cells_of(drawing)
    samples.check_holes(cells, samples.extent(cells), PATH, True)
    with pytest.raises(FileError):
        samples.check_holes(cells, samples.extent(cells), PATH, None)
