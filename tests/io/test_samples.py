"""Options of the reader, windows of views, and grids with holes."""

import inspect
import math
from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import lenslets, read, samples
from lfref.io.samples import ReadOptions
from tests.io.lenslet_drawing import made

PATH = Path("field")


def test_every_option_of_the_reader_has_its_default():
    parameters = dict(inspect.signature(read.read).parameters)
    del parameters["path"]
    assert ReadOptions.parse(**{name: one.default for name, one in parameters.items()}) == ReadOptions()


def test_lists_of_a_configuration_are_as_good_as_tuples(view_folder):
    folder = view_folder({(0, index): f"{index}.png" for index in range(6)})
    field = read.read(folder, angular_size=[2, 2], grid=[2, 3], size=[2, 1], spacing=[1, 2], pattern="index")
    assert (field.grid, field.size, field.positions.shape) == ((2, 2), (2, 1), (2, 2, 2))


@pytest.mark.parametrize(
    ("n_views", "count", "start", "first"),
    [(14, 7, None, 4), (14, 7, 3, 3), (14, 7, 7, 7), (9, 7, None, 1), (9, 9, None, 0), (9, 1, None, 4)],
)
def test_the_window_is_central_unless_it_has_a_start(n_views, count, start, first):
    rows, columns = ReadOptions((count, count), start).window((n_views, n_views), PATH)
    assert rows == columns == slice(first, first + count)


@pytest.mark.parametrize(("count", "start"), [(0, None), (8, None), (7, 1), (3, -1), (3, 5)])
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


def test_options_count_more_than_what_an_image_shows():
    shown = made()
    assert lenslets.overridden(shown, ReadOptions.parse(calibration="w.png")) == shown
    assert lenslets.overridden(shown, ReadOptions.parse(offset=[1, 2])).origin == (1, 2)
    turned = lenslets.overridden(shown, ReadOptions.parse(rotation=-1))
    assert (turned.rotation, turned.pitch) == (pytest.approx(-1), pytest.approx(shown.pitch))
    assert lenslets.overridden(shown, ReadOptions.parse(lattice="hexagonal")).is_hexagonal


@pytest.mark.parametrize(
    "wrong",
    [
        {"size": 5}, {"lenslet": "a"}, {"lenslet": 0}, {"pitch": "wide"}, {"pitch": 1}, {"pitch": [14, 0]},
        {"pitch": 1.7, "lattice": "hexagonal"}, {"pitch": math.nan}, {"pitch": 14, "offset": [3, math.inf]},
        {"pitch": 14, "rotation": 46}, {"pitch": 14, "rotation": math.nan}, {"rotation": 1}, {"lattice": "round"},
        {"spacing": 1.1}, {"spacing": [0, 1]},
    ],
)  # fmt: skip
def test_impossible_options_are_refused(wrong):
    with pytest.raises(InputError):
        lattice(**wrong)


def test_only_the_views_of_the_window_are_loaded_and_each_once():
    cells = {(row, column): (row, column) for row in range(3) for column in range(4)}
    loaded = []

    def load(cell: tuple[int, int]) -> np.ndarray:
        loaded.append(cell)
        return np.full((2, 3, 1), 10 * cell[0] + cell[1], np.uint8)

    colours, weight = samples.gather(cells, (slice(1, 3), slice(2, 4)), load)
    assert loaded == [(1, 2), (1, 3), (2, 2), (2, 3)]
    assert colours.shape == (2, 2, 1, 2, 3)
    assert colours[:, :, 0, 0, 0].tolist() == [[12, 13], [22, 23]]
    assert weight is None


def cells_of(drawing: str) -> dict[tuple[int, int], int]:
    """A grid whose views are the crosses of a drawing."""
    rows = drawing.split()
    return {(row, column): 0 for row, line in enumerate(rows) for column, mark in enumerate(line) if mark == "x"}


ON_PURPOSE = {
    "cross": "..x.. ..x.. xxxxx ..x.. ..x..", "diagonal": "x... .x.. ..x. ...x",
    "both diagonals": "x...x .x.x. ..x.. .x.x. x...x", "no corners": ".xxx. xxxxx xxxxx xxxxx .xxx.",
}  # fmt: skip
BY_ACCIDENT = {
    "one missing": "xxx xxx x.x", "the middle missing": "xxx x.x xxx", "the last missing": "xxxx xxxx xxxx ...x",
    "a copy cut short": "xxxxx xxxxx xxxxx xx... ....x",
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


@pytest.mark.parametrize(("channels", "kind"), [(1, np.uint8), (3, np.uint16), (3, np.float32), (4, np.uint8)])
def test_holes_have_weight_zero_and_the_mean_of_the_other_views(channels, kind):
    full = 1 if kind is np.float32 else np.iinfo(kind).max
    stored = {
        cell: np.full((2, 3, channels), (cell[0] + cell[1] + 1) / 4 * full).astype(kind) for cell in [(0, 0), (1, 1)]
    }
    cells = {cell: cell for cell in stored}
    colours, weight = samples.gather(cells, (slice(0, 2), slice(0, 2)), stored.get)
    n_colours = channels - 1 + channels % 2
    assert (colours.shape, colours.dtype, weight.dtype) == ((2, 2, n_colours, 2, 3), kind, kind)
    expected = np.mean([view[..., :n_colours] for view in stored.values()])
    for hole in ((0, 1), (1, 0)):
        np.testing.assert_allclose(colours[hole], expected, atol=0.5 if kind is not np.float32 else 1e-6)
        assert not weight[hole].any()
    for cell, view in stored.items():
        np.testing.assert_array_equal(colours[cell], view[..., :n_colours].transpose(2, 0, 1))
        assert (weight[cell] == (view[..., -1] if channels == 4 else full)).all()


def test_a_window_of_nothing_but_holes_is_refused():
    with pytest.raises(FileError):
        samples.gather({(0, 0): 0}, (slice(1, 2), slice(1, 2)), lambda cell: np.zeros((1, 1, 1)))
