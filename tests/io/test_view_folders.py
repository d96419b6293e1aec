"""Folders of views: names, arrangements on the grid, and what is read."""

import itertools

import numpy as np
import OpenImageIO
import pytest

from lfref.errors import LfrefError
from lfref.io import images, read, view_folders

GRID = list(np.ndindex(3, 3))
NAMINGS = {
    "HCI": lambda row, column: f"input_Cam{3 * row + column:03d}.png",
    "from 0": lambda row, column: f"scene_{row:02d}_{column:02d}.png",
    "from 1": lambda row, column: f"my_scene_2_{row + 1:02d}_{column + 1:02d}.png",
    "gantry": lambda row, column: f"out_{row:02d}_{column:02d}_-{row}.134705_-3355.33{column}_.png",
    "from 8, past 9": lambda row, column: f"s_{row + 8}_{column + 8}.png",
    "R_C": lambda row, column: f"{row}_{column}.png",
    "RxC": lambda row, column: f"{row}x{column}.png",
    "signs": lambda row, column: f"image_{row - 1:+d}_{column - 1:+d}.png",
    "minus": lambda row, column: f"view_{row - 1}_{column - 2}.png",
    "view-RR-CC": lambda row, column: f"view-{row + 1:02d}-{column + 1:02d}.png",
    "name that ends in a number": lambda row, column: f"IMG-2019-{row:02d}_{column:02d}.png",
    "every third": lambda row, column: f"s_{3 * row + 1:02d}_{3 * column + 1:02d}.png",
    "u and v": lambda row, column: f"scene_u{column:02d}v{row:02d}.png",
    "row and column": lambda row, column: f"my_row{row + 1}_col{column + 1}.png",
    "s and t": lambda row, column: f"S{column}_T{row}.png",
    "1": lambda row, column: f"{3 * row + column + 1}.png",
    "numbered": lambda row, column: f"frame_{3 * row + column + 1:04d}.png",
    "numbered behind three digits": lambda row, column: f"seq_001_{3 * row + column:04d}.png",
}
EXPECTED = [[0, 1, 2], [10, 11, 12], [20, 21, 22]]


def names(naming) -> dict[tuple[int, int], str]:
    return {cell: NAMINGS.get(naming, naming)(*cell) for cell in GRID}


@pytest.mark.parametrize("naming", NAMINGS)
def test_known_names_find_their_place(view_folder, numbered_views, naming):
    folder = view_folder(names(naming))
    field = read.read(folder)
    assert numbered_views(field.views) == EXPECTED
    expected = {"path": str(folder), "format": "folder", "bits": "8", "encoding": "srgb"}
    assert (field.name, field.metadata) == ("field", expected)


def test_left_and_right_are_a_row_of_two_views(view_folder, numbered_views):
    folder = view_folder({(0, 0): "room_left.png", (0, 1): "room_right.png"})
    assert numbered_views(read.read(folder).views) == [[0, 1]]


def test_a_light_field_one_level_below_is_named(view_folder):
    folder = view_folder(names("from 0"), "capture/images").parent
    with pytest.raises(LfrefError, match="capture/images"):
        read.read(folder)
    assert read.find(folder) == [folder / "images"]


NUMBERED = [f"photo{index}.png" for index in range(8)]
REFUSED = {
    "nothing": ([], {}),
    "another picture": (["holiday.png"], {}),
    "a missing view": ([name for cell, name in names("from 1").items() if cell != (1, 1)], {}),
    "a missing number": ([name for cell, name in names("HCI").items() if cell != (1, 1)], {}),
    "a view twice": ([*names("from 0").values(), "scene_1_2.png"], {}),
    "two light fields": ([*names("from 0").values(), "other_00_00.png", "other_00_01.png"], {}),
    "numbers that are no square": (NUMBERED, {"pattern": "index"}),
    "numbers beyond the grid": (NUMBERED, {"pattern": "index", "grid": (2, 2)}),
    "billions of rows": (["a_0_0.png", "a_99999999_99999999.png"], {"pattern": r"_(?P<row>\d+)_(?P<column>\d+)"}),
    "billions of numbers": (["input_Cam0.png", "input_Cam99999999999.png"], {}),
    "a pattern that is none": (NUMBERED, {"pattern": "("}),
    "a pattern without columns": (NUMBERED, {"pattern": r"(?P<row>\d)"}),
    "groups that are no numbers": (["a_b.png", "c_d.png"], {"pattern": r"(?P<row>\w)_(?P<column>\w)"}),
    "names without positions": (list(names("HCI").values()), {"positions": "names"}),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_folders_that_are_no_light_field_are_one_line(view_folder, tmp_path, kind, one_line):
    files, options = REFUSED[kind]
    (tmp_path / "field").mkdir()
    folder = view_folder({(0, index): name for index, name in enumerate(files)})
    with pytest.raises(LfrefError) as caught:
        read.read(folder, **options)
    one_line(caught.value)


@pytest.mark.parametrize(
    ("naming", "foreign"),
    [("from 0", "preview.png"), ("from 0", "thumb_1_2.png"), ("HCI", "objectids_highres.png"), ("1", "depth.png")],
)
def test_a_picture_that_is_no_view_is_left_out_and_named(view_folder, numbered_views, caplog, naming, foreign):
    folder = view_folder(names(naming))
    for name in ("README.txt", ".hidden_00_00.png"):
        (folder / name).write_bytes(b"x")
    images.write_image(folder / foreign, np.zeros((5, 4, 3)))
    with caplog.at_level("INFO", "lfref"):
        assert numbered_views(read.read(folder).views) == EXPECTED
    assert foreign in caplog.text
    assert "README" not in caplog.text


@pytest.mark.parametrize(
    ("first", "last", "count", "expected"),
    [
        (7, 15, 9, (3, 7)),
        (1, 25, 9, (5, 1)),  # a cross, or a diagonal
        (2, 22, 5, (5, 0)),  # the upper and the lower end are missing
        (0, 14, 15, None),
    ],
)
def test_numbers_make_a_square_if_they_are_complete_or_symmetric(first, last, count, expected):
    assert view_folders.square(first, last, count) == expected


CROSS = [cell for cell in np.ndindex(5, 5) if 2 in cell]
DIAGONALS = [cell for cell in np.ndindex(5, 5) if cell[0] == cell[1] or sum(cell) == 4]


@pytest.mark.parametrize("cells", [CROSS, DIAGONALS], ids=["cross", "diagonals"])
@pytest.mark.parametrize(
    "naming",
    [
        lambda row, column: f"view_{row + 1}_{column + 1}.png",
        lambda row, column: f"input_Cam{5 * row + column:03d}.png",
        lambda row, column: f"{5 * row + column + 1:02d}.png",
    ],
    ids=["row and column", "from 0", "from 1"],
)
def test_crosses_and_diagonals_are_read_with_weight_zero_elsewhere(view_folder, numbered_views, cells, naming):
    field = read.read(view_folder({cell: naming(*cell) for cell in cells}))
    numbers, weight = numbered_views(field.views), field.weight.flatten(2)
    for row, column in itertools.product(range(5), range(5)):
        if (row, column) in cells:
            assert numbers[row][column] == 10 * row + column
        assert weight[row, column].unique().tolist() == [float((row, column) in cells)]
    assert field.metadata["missing"] == f"{25 - len(cells)} of 25 views"


@pytest.mark.parametrize(
    ("suffix", "space", "expected"),
    [
        ("png", "sRGB", "srgb"),
        ("png", "Gamma1.8", "gamma:1.8"),
        ("tif", None, "linear"),
    ],
)
def test_the_encoding_is_that_of_the_header_and_floats_are_linear(tmp_path, suffix, space, expected):
    for column in range(2):
        path = str(tmp_path / f"a_00_{column:02d}.{suffix}")
        spec = OpenImageIO.ImageSpec(4, 4, 3, "uint8" if space else "float")
        if space:
            spec.attribute("oiio:ColorSpace", space)
        output = OpenImageIO.ImageOutput.create(path)
        assert output.open(path, spec)
        assert output.write_image(np.full((4, 4, 3), 0.5, "f4"))
        assert output.close()
    assert read.read(tmp_path).metadata["encoding"] == expected
    assert not read.read(tmp_path, encoding="none").is_linear
