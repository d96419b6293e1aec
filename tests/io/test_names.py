"""What a name says, and which name a missing view would have."""

from pathlib import Path

import pytest

from lfref.errors import FileError, InputError
from lfref.io import view_folders

SAID = {
    "out_03_14_-776.880371_-3355.331299_.png": (
        "gantry",
        {"row": "03", "column": "14", "v": "-776.880371", "u": "-3355.331299"},
    ),
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
    ((found,),) = view_folders.known([Path(name)])
    pattern, said = SAID[name]
    assert found.match.re.pattern == view_folders.PATTERNS[pattern]
    assert said.items() <= found.match.groupdict().items()


@pytest.mark.parametrize(
    "name", ["0001.png", "IMG_20190101_0001.png", "depth.png", "IMG_1085_eslf.png", "a_1_2345.png", "start1_s2.png"]
)
def test_other_names_leave_it_open(name):
    assert view_folders.known([Path(name)]) == []


def test_a_picture_on_its_own_is_left_out_beside_numbered_ones():
    numbered = [Path(f"a{index}.png") for index in range(3)]
    (field,) = view_folders.numbered([Path("depth1.png"), *numbered])
    assert [found.path for found in field] == numbered
    assert len(view_folders.numbered([Path("depth1.png")])) == 1


def test_a_missing_view_is_named_as_widely_as_the_others():
    ((found,),) = view_folders.known([Path("s_08_09.png")])
    assert found.renamed({"row": 3, "column": 12}) == "s_03_12.png"


def test_a_user_names_a_pattern_or_writes_one(one_line):
    assert view_folders.compiled("column_row").pattern == view_folders.ASKED["column_row"]
    assert view_folders.numbering(view_folders.compiled(r"(?P<index>\d+)")) == ("index",)
    for wrong in ("(", "columns", r"(?P<row>\d)"):
        with pytest.raises(InputError) as caught:
            view_folders.compiled(wrong)
        one_line(caught.value, "reader.pattern", "row_column", repr(wrong)[1:-1])


def test_the_same_numbers_twice_are_refused(one_line):
    (found,) = view_folders.known([Path("f/s_1_2.png"), Path("f/s_01_02.png")])
    with pytest.raises(FileError) as caught:
        view_folders.by_numbers(found, ("row", "column"))
    one_line(caught.value, "s_1_2.png and s_01_02.png", "once")
