"""Folders of views: each name in its place, each fault named."""

import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import images, read, views

GRID = [(row, column) for row in range(3) for column in range(3)]
NAMINGS = {
    "HCI": lambda row, column: f"input_Cam{3 * row + column:03d}.png",
    "from 0": lambda row, column: f"scene_{row:02d}_{column:02d}.png",
    "from 1": lambda row, column: f"my_scene_2_{row + 1:02d}_{column + 1:02d}.png",
    "one digit": lambda row, column: f"2067_{row + 1}_{column + 1}.png",
    "gantry": lambda row, column: f"out_{row:02d}_{column:02d}_-{row}.134705_-3355.33{column}_.png",
    "gantry, no tail": lambda row, column: f"out_{row:02d}_{column:02d}_-{row}.134705_3355.33{column}.png",
    "from 8, past 9": lambda row, column: f"s_{row + 8}_{column + 8}.png",
}
EXPECTED = [[0, 1, 2], [10, 11, 12], [20, 21, 22]]


def names(naming) -> dict[tuple[int, int], str]:
    return {cell: naming(*cell) for cell in GRID}


@pytest.mark.parametrize("naming", NAMINGS.values(), ids=NAMINGS)
def test_known_names_find_their_place(view_folder, numbered_views, naming):
    folder = view_folder(names(naming))
    field = read.read(folder)
    assert numbered_views(field.views) == EXPECTED
    assert field.views.shape == (3, 3, 1, 2, 3)
    assert (field.name, field.metadata) == ("field", {"path": str(folder), "format": "folder", "bits": "8"})


@pytest.mark.parametrize(
    ("pattern", "naming"),
    [
        (r"row(?P<row>\d)col(?P<column>\d)", lambda row, column: f"row{row}col{column}.png"),
        (r"c(?P<column>\d)r(?P<row>\d)\.png$", lambda row, column: f"c{column}r{row}.png"),
        (r"^(?P<index>\d+)\.", lambda row, column: f"{3 * row + column + 1}.png"),
    ],
)
def test_a_pattern_of_ones_own_finds_its_place(view_folder, numbered_views, pattern, naming):
    folder = view_folder(names(naming))
    assert numbered_views(read.read(folder, pattern=pattern).views) == EXPECTED


@pytest.mark.parametrize(
    "pattern", ["(", r"(\d+)_(\d+)", r"(?P<row>\d+)", r"(?P<row>\d+)_(?P<column>\d+)_(?P<index>\d+)"]
)
def test_a_pattern_that_cannot_place_views_is_refused(view_folder, pattern, one_line):
    with pytest.raises(InputError) as caught:
        read.read(view_folder(names(NAMINGS["from 0"])), pattern=pattern)
    one_line(caught.value, "pattern")


def test_groups_that_are_no_numbers_are_refused(view_folder):
    folder = view_folder({(0, 0): "a_b.png"})
    with pytest.raises(InputError, match="must be numbers"):
        read.read(folder, pattern=r"(?P<row>\w)_(?P<column>\w)")


@pytest.mark.parametrize("naming", [NAMINGS["HCI"], NAMINGS["from 0"], NAMINGS["from 1"], NAMINGS["one digit"]])
@pytest.mark.parametrize("cell", [(1, 1), (2, 2), (0, 1)])
def test_a_missing_view_is_named(view_folder, naming, cell, one_line):
    folder = view_folder(names(naming))
    (folder / naming(*cell)).unlink()
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, naming(*cell), "add the missing")


def test_a_missing_gantry_view_is_named_by_row_and_column(view_folder, one_line):
    folder = view_folder(names(NAMINGS["gantry"]))
    next(folder.glob("out_01_02_*")).unlink()
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, "out_01_02_")


def test_a_pattern_with_index_names_the_missing_view(view_folder, one_line):
    folder = view_folder({(0, index): f"{index}.png" for index in (0, 1, 3)})
    with pytest.raises(FileError) as caught:
        read.read(folder, pattern=r"^(?P<index>\d+)\.")
    one_line(caught.value, folder, "2.png")


@pytest.mark.parametrize("count", [8, 10, 15])
def test_row_major_names_must_be_a_square_number(view_folder, count, one_line):
    folder = view_folder({(0, index): f"input_Cam{index:03d}.png" for index in range(count)})
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, "square", f"got {count}", f"input_Cam{count:03d}.png")


def test_a_stray_name_of_billions_is_refused_at_once(view_folder):
    folder = view_folder({(0, 0): "a_00_00.png", (0, 1): "a_99999999_99999999.png"})
    with pytest.raises(FileError, match="missing"):
        read.read(folder)
    folder = view_folder({(0, 0): "input_Cam0.png", (0, 1): "input_Cam99999999999.png"}, "hci")
    with pytest.raises(FileError, match=r"no input_Cam1\.png"):
        read.read(folder)


@pytest.mark.parametrize(
    "second", [{(0, 0): "other_00_00.png"}, {(0, 0): "input_Cam000.png"}, {(0, 0): "out_00_00_1.0_2.0_.png"}]
)
def test_two_light_fields_in_one_folder_are_refused(view_folder, second, one_line):
    view_folder(names(NAMINGS["from 0"]))
    folder = view_folder(second)
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, second[0, 0], "scene_00_00.png", "pattern")


def test_a_pattern_chooses_one_of_two_light_fields(view_folder, numbered_views):
    view_folder(names(NAMINGS["from 0"]))
    folder = view_folder({(0, 7): "other_00_00.png"})
    field = read.read(folder, pattern=r"^other_(?P<row>\d+)_(?P<column>\d+)")
    assert numbered_views(field.views) == [[7]]


def test_a_view_that_is_there_twice_is_refused(view_folder, one_line):
    folder = view_folder({**names(NAMINGS["from 0"]), (9, 9): "scene_1_2.png"})
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, "scene_1_2.png", "scene_01_02.png", "once")


@pytest.mark.parametrize(
    "odd", [np.zeros((2, 4, 1), np.uint8), np.zeros((2, 3, 1), np.uint16), np.zeros((2, 3, 3), np.uint8)]
)
def test_a_view_of_another_size_type_or_channel_count_is_named(view_folder, odd, one_line):
    folder = view_folder(names(NAMINGS["from 0"]))
    images.write_image(folder / "scene_01_01.png", odd)
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder / "scene_01_01.png", "alike")


def test_a_damaged_view_is_named(view_folder, one_line):
    folder = view_folder(names(NAMINGS["from 0"]))
    (folder / "scene_02_01.png").write_bytes((folder / "scene_02_01.png").read_bytes()[:-3])
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder / "scene_02_01.png", "copy it again")


def test_an_empty_folder_and_one_of_other_names_are_refused(tmp_path, one_line):
    with pytest.raises(FileError) as caught:
        read.read(tmp_path)
    one_line(caught.value, tmp_path, "must hold images")
    images.write_image(tmp_path / "holiday.png", np.zeros((2, 2, 3)))
    with pytest.raises(FileError) as caught:
        read.read(tmp_path)
    one_line(caught.value, tmp_path, "holiday.png", "pattern")


def test_other_files_of_a_folder_are_left_alone(view_folder, numbered_views):
    folder = view_folder({**names(NAMINGS["HCI"]), (9, 9): "objectids_highres.png"})
    (folder / "parameters.cfg").write_text("x")
    (folder / "gt_disp_lowres.pfm").write_text("x")
    (folder / ".hidden_00_00.png").write_text("x")
    assert numbered_views(read.read(folder).views) == EXPECTED


def test_alpha_of_views_is_the_weight(tmp_path):
    for row, column in GRID:
        images.write_image(tmp_path / f"a_{row}_{column}.png", np.full((2, 3, 4), (10, 20, 30, 40 + row), np.uint8))
    field = read.read(tmp_path)
    assert field.views.shape == (3, 3, 3, 2, 3)
    assert field.weight.shape == (3, 3, 1, 2, 3)
    assert (field.weight[2] * 255).unique().tolist() == [42]
    assert (field.views[..., 1, :, :] * 255).unique().tolist() == [20]


def test_one_view_given_alone_is_not_taken_for_an_eslf(view_folder, one_line):
    folder = view_folder(names(NAMINGS["from 0"]))
    assert views.is_view(folder / "scene_00_00.png")
    with pytest.raises(FileError) as caught:
        read.read(folder / "scene_00_00.png")
    one_line(caught.value, folder / "scene_00_00.png", f"read {folder}")
