"""Every option of the reader is held against its kind, before anything is read."""

import inspect

import pytest

from lfref.errors import InputError
from lfref.io import options, read

WRONG = {
    "views": ["a", [3], [3, 3, 3], 3.5, True],
    "start": ["a", 1.5],
    "reverse_v": ["yes", 1],
    "reverse_u": [0],
    "pattern": [3],
    "lenslet": ["a", 14.3, None],
    "rotation": ["a", [1], True],
    "white": [3, ["a"]],
    "size": [5, [5], ["a", 5]],
    "grid": [5, [1, 2, 3], "ab"],
    "holes": ["maybe", 1],
    "axes": [5],
    "variable": [5],
    "positions": [3, [1, 2]],
    "spacing": [1.1, [1, "a"], [1, 2, 3], [True, 1]],
    "scratch": [3, [1]],
    "encoding": [2.2, None, ["srgb"]],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_an_option_of_another_kind_is_named(tmp_path, name, value, one_line):
    with pytest.raises(InputError) as caught:
        read.read(tmp_path, **{name: value})
    one_line(caught.value, f"reader.{name}", repr(value))


def test_no_kind_is_left_that_no_option_has():
    assert options.KINDS.keys() <= inspect.signature(read.read).parameters.keys()
    assert WRONG.keys() == options.KINDS.keys()


def test_lists_of_a_configuration_are_as_good_as_tuples(view_folder):
    folder = view_folder({(0, index): f"{index}.png" for index in range(6)})
    field = read.read(folder, views=[2, 2], grid=[2, 3], size=[2, 1], spacing=[1, 2], pattern="index")
    assert (field.grid, field.size, field.positions.shape) == ((2, 2), (2, 1), (2, 2, 2))
