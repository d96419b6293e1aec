"""Names of views: which pattern they follow, and the line for names that follow none."""

import itertools
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from lfref.errors import FileError, InputError
from lfref.io import images, read, view_names

SAID = {
    "out_03_14_-776.880371_-3355.331299_.png": (
        "gantry",
        {"row": "03", "column": "14", "v": "-776.880371", "u": "-3355.331299"},
    ),
    "out_00_05_-381.909271_1103.376221.png": (
        "gantry",
        {"row": "00", "column": "05", "v": "-381.909271", "u": "1103.376221"},
    ),
    "IMG_12_05_-3.25_10.000_30_36.jpg": ("gantry", {"row": "12", "column": "05", "v": "-3.25", "u": "10.000"}),
    "input_Cam080.png": ("HCI", {"index": "080"}),
    "v3_u14.png": ("v_u", {"row": "3", "column": "14"}),
    "scene_row03col14.png": ("v_u", {"row": "03", "column": "14"}),
    "S14_T3.png": ("u_v", {"row": "3", "column": "14"}),
    "3_14.png": ("row_column", {"row": "3", "column": "14"}),
    "view-03-14.tif": ("row_column", {"row": "03", "column": "14"}),
    "2067_03_14.png": ("row_column", {"row": "03", "column": "14"}),
    "IMG_20190101_03x14.jpg": ("row_column", {"row": "03", "column": "14"}),
}


@pytest.mark.parametrize("name", SAID)
def test_a_name_is_of_the_first_pattern_that_it_follows(name):
    ((found,),) = view_names.fields_of([Path(name)])
    pattern, said = SAID[name]
    assert found.match.re.pattern == view_names.PATTERNS[pattern]
    assert said.items() <= found.match.groupdict().items()


@pytest.mark.parametrize(
    "name",
    [
        "0001.png",
        "IMG_20190101_0001.png",
        "depth.png",
        "IMG_1085_eslf.png",
        "a_1_2345.png",
        "start1_s2.png",
        "2025-08-06_00.30.jpg",
    ],
)
def test_other_names_leave_it_open(name):
    assert view_names.fields_of([Path(name)]) == []


def test_a_user_names_a_pattern_or_writes_one(one_line):
    assert view_names.compiled("column_row").pattern == view_names.AMBIGUOUS_PATTERNS["column_row"]
    assert view_names.compiled(r"(?P<index>\d+)").groupindex.keys() == {"index"}
    for wrong in ("(", "columns", r"(?P<row>\d)"):
        with pytest.raises(InputError) as caught:
            view_names.compiled(wrong)
        one_line(caught.value, "reader.pattern", "row_column", repr(wrong)[1:-1])


GRID = list(itertools.product(range(3), range(4)))
UNKNOWN = {
    "numbers behind words": lambda row, column: f"camA{row}at{column}z.png",
    "counter beside the grid": lambda row, column: f"shot{4 * row + column}_row_{row}__at {column}.png",
    "column first, quotes and a sign": lambda row, column: f'it\'s x{column}y{row} "q" ${{n}}.png',
    "numbers of four digits": lambda row, column: f"a{1000 + row}b{2000 + column}_1.5.png",
    "numbers below 0": lambda row, column: f"cam_{row - 1}_{column - 2}.png",
    "numbered through": lambda row, column: f"left{4 * row + column}right.png",
}
"""Names of 3x4 views that no pattern reads as they are."""


def pasted(message: str) -> dict:
    """The options of the reader that a message ends in, by the shell and Hydra."""
    words = shlex.split(message[re.search(r"set (.*)", message).start(1) :])
    overrides = OverridesParser.create().parse_overrides([word for word in words if word.startswith("reader.")])
    return {one.key_or_group.removeprefix("reader."): one.value() for one in overrides}


@pytest.mark.parametrize("kind", UNKNOWN)
def test_a_message_gives_the_line_that_reads_all_the_files(view_folder, numbered_views, kind):
    folder = view_folder({cell: UNKNOWN[kind](*cell) for cell in GRID})
    images.write_image(folder / "thumbnail.png", np.zeros((1, 1, 1)))
    with pytest.raises(FileError, match=r"reader\.pattern") as caught:
        read.read(folder)
    assert "\n" not in str(caught.value)
    options = pasted(str(caught.value))
    expected = [[10 * row + column for column in range(4)] for row in range(3)]
    if kind == "numbered through":
        expected = [list(itertools.chain(*expected))]
        assert options["grid"] == [1, 12]
    assert numbered_views(read.read(folder, **options).views) == expected


def test_of_two_light_fields_the_line_reads_the_first(view_folder, numbered_views):
    for name in ("left", "right"):
        folder = view_folder({cell: f"{name}_{cell[0]}_{cell[1]}.png" for cell in GRID})
    with pytest.raises(FileError, match="one light field") as caught:
        read.read(folder)
    options = pasted(str(caught.value))
    assert read.read(folder, **options).grid == (3, 4)
    (folder / "right_2_3.png").unlink()
    assert read.read(folder, **options).grid == (3, 4)


@pytest.mark.parametrize(
    "found",
    [
        ["holiday.png", "cat.png"],
        ["cam1at1z.png", "cam1at2z.png", "cam2at1z.png"],
        ["cam1at1z.png", "cam1at5z.png", "cam2at1z.png", "cam2at5z.png"],
        ["a1z.png", "a2z.png", "a4z.png"],
    ],
)
def test_names_without_a_full_even_grid_get_no_line(found):
    paths = [Path(name) for name in found]
    assert view_names.fitting_option(paths, paths) == ""


def test_the_known_pattern_is_named_where_it_reads_the_same():
    paths = [Path(f"IMG_20190101_{number:04d}.jpg") for number in range(9)]
    assert view_names.fitting_option(paths, paths) == "reader.pattern=index"
    assert view_names.fitting_option(paths[1:], paths[1:]) == "reader.pattern=index reader.grid=[1,8]"
