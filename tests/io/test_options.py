"""Options of the reader: each checked before anything is read; windows of views; what options tell of lenslets."""

import inspect
import math
from pathlib import Path

import pytest

from lfref.errors import InputError
from lfref.io import lenslets, read
from lfref.io.samples import ReadOptions
from tests.io.lenslet_drawing import made


@pytest.mark.parametrize(
    "wrong", [{"size": 5}, {"lenslet": "a"}, {"pitch": "wide"}, {"spacing": 1.1}, {"rotation": "a"}]
)
def test_an_option_of_another_kind_is_one_line(tmp_path, wrong, one_line):
    with pytest.raises(InputError) as caught:
        read.read(tmp_path, **wrong)
    one_line(caught.value, "=".join(f"{name}={value!r}" for name, value in wrong.items()))


def test_every_option_of_the_reader_has_its_default():
    parameters = dict(inspect.signature(read.read).parameters)
    del parameters["path"]
    assert ReadOptions.parse(**{name: one.default for name, one in parameters.items()}) == ReadOptions()


def test_lists_of_a_configuration_are_as_good_as_tuples(view_folder):
    folder = view_folder({(0, index): f"{index}.png" for index in range(6)})
    field = read.read(folder, views=[2, 2], grid=[2, 3], size=[2, 1], spacing=[1, 2], pattern="index")
    assert (field.grid, field.size, field.positions.shape) == ((2, 2), (2, 1), (2, 2, 2))


@pytest.mark.parametrize(
    ("n_views", "count", "start", "first"),
    [(14, 7, None, 4), (14, 7, 3, 3), (14, 7, 7, 7), (9, 7, None, 1), (9, 9, None, 0), (9, 1, None, 4)],
)
def test_the_window_is_central_unless_it_has_a_start(n_views, count, start, first):
    rows, columns = ReadOptions((count, count), start).window((n_views, n_views), Path("field"))
    assert rows == columns == slice(first, first + count)


@pytest.mark.parametrize(("count", "start"), [(0, None), (8, None), (7, 1), (3, -1), (3, 5)])
def test_a_window_that_leaves_the_grid_is_refused(count, start, one_line):
    with pytest.raises(InputError) as caught:
        ReadOptions((count, count), start).window((7, 7), Path("field"))
    one_line(caught.value, "field", "among the 7", f"views {count}", "reader.views and reader.start")


def lattice(**given):
    return lenslets.lattice_of_options(ReadOptions.parse(**given))


def test_one_pitch_is_that_of_neighbours():
    assert lattice(pitch=14.29).pitch == pytest.approx((14.29, 14.29))
    hexagonal = lattice(pitch=14.29, lattice="hexagonal")
    assert hexagonal.pitch == pytest.approx((14.29 * math.sqrt(3) / 2, 14.29))
    assert hexagonal.is_hexagonal
    assert lattice(pitch=[12, 15]).pitch == pytest.approx((12, 15))


def test_options_count_more_than_what_an_image_shows():
    shown = made()
    assert lenslets.overridden(shown, ReadOptions.parse(white="w.png")) == shown
    assert lenslets.overridden(shown, ReadOptions.parse(offset=[1, 2])).origin == (1, 2)
    turned = lenslets.overridden(shown, ReadOptions.parse(rotation=-1))
    assert (turned.rotation, turned.pitch) == (pytest.approx(-1), pytest.approx(shown.pitch))
    assert lenslets.overridden(shown, ReadOptions.parse(lattice="hexagonal")).is_hexagonal


@pytest.mark.parametrize(
    ("given", "part"),
    [
        ({"pitch": 1}, "at least 2"),
        ({"pitch": [14, 0]}, "at least 2"),
        ({"pitch": 1.7, "lattice": "hexagonal"}, "at least 2"),
        ({"pitch": math.nan}, "finite"),
        ({"pitch": 14, "offset": [3, math.inf]}, "finite"),
        ({"pitch": 14, "rotation": 46}, "-45 to 45"),
        ({"pitch": 14, "rotation": math.nan}, "-45 to 45"),
        ({"spacing": [0, 1]}, "above 0"),
        ({"rotation": 1}, "set reader.pitch"),
    ],
)
def test_impossible_lenslets_and_spacings_are_one_line(given, part, one_line):
    with pytest.raises(InputError) as caught:
        lattice(**given)
    one_line(caught.value, part)
