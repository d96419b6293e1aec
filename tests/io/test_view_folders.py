"""Folders of views: names, arrangements on the grid, and what is read."""

import itertools
import struct

import numpy as np
import OpenImageIO
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfref.errors import InputError, LfrefError
from lfref.io import images, read, view_folders
from lfref.io.samples import ReadOptions

GRID = list(np.ndindex(3, 3))
NAMINGS = {
    "HCI": lambda row, column: f"input_Cam{3 * row + column:03d}.png",
    "from 0": lambda row, column: f"scene_{row:02d}_{column:02d}.png",
    "from 1": lambda row, column: f"my_scene_2_{row + 1:02d}_{column + 1:02d}.png",
    "gantry": lambda row, column: f"out_{row:02d}_{column:02d}_-{row}.134705_-3355.33{column}_.png",
    "gantry, no tail": lambda row, column: f"out_{row:02d}_{column:02d}_-{row}.134705_3355.33{column}.png",
    "from 8, past 9": lambda row, column: f"s_{row + 8}_{column + 8}.png",
    "R_C": lambda row, column: f"{row}_{column}.png",
    "R-C": lambda row, column: f"{row + 1}-{column + 1}.png",
    "RxC": lambda row, column: f"{row}x{column}.png",
    "view-RR-CC": lambda row, column: f"view-{row + 1:02d}-{column + 1:02d}.png",
    "name that ends in a number": lambda row, column: f"IMG-2019-{row:02d}_{column:02d}.png",
    "every third": lambda row, column: f"s_{3 * row + 1:02d}_{3 * column + 1:02d}.png",
    "v and u": lambda row, column: f"v{row}_u{column}.png",
    "u and v": lambda row, column: f"scene_u{column:02d}v{row:02d}.png",
    "row and column": lambda row, column: f"my_row{row + 1}_col{column + 1}.png",
    "s and t": lambda row, column: f"S{column}_T{row}.png",
    "000": lambda row, column: f"{3 * row + column:03d}.png",
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


@pytest.mark.parametrize(
    ("pattern", "naming"),
    [
        (r"row(?P<row>\d)col(?P<column>\d)", lambda row, column: f"row{row}col{column}.png"),
        (r"c(?P<column>\d)r(?P<row>\d)\.png$", lambda row, column: f"c{column}r{row}.png"),
        (r"^(?P<index>\d+)\.", lambda row, column: f"{3 * row + column + 1}.png"),
        ("column_row", lambda row, column: f"{column}_{row}.png"),
        ("index", lambda row, column: f"photo{3 * row + column}.png"),
        ("serpentine", lambda row, column: f"{3 * row + (2 - column if row % 2 else column)}.png"),
    ],
)
def test_a_pattern_of_the_user_finds_the_place(view_folder, numbered_views, pattern, naming):
    assert numbered_views(read.read(view_folder(names(naming)), pattern=pattern).views) == EXPECTED


@pytest.mark.parametrize("wrong", ["(", "columns", r"(?P<row>\d)"])
def test_what_is_no_pattern_is_refused(wrong):
    with pytest.raises(InputError):
        view_folders.compiled(wrong)


def test_a_grid_that_is_no_square_is_numbered_where_the_option_says_so(view_folder, numbered_views):
    folder = view_folder({(row, column): f"{3 * row + column}.png" for row in range(2) for column in range(3)})
    assert numbered_views(read.read(folder, pattern="index", grid=(2, 3)).views) == [[0, 1, 2], [10, 11, 12]]


NUMBERED = [f"photo{index}.png" for index in range(8)]
REFUSED = {
    "nothing": ([], {}),
    "another picture": (["holiday.png"], {}),
    "a missing view": ([name for cell, name in names("from 1").items() if cell != (1, 1)], {}),
    "a missing number": ([name for cell, name in names("HCI").items() if cell != (1, 1)], {}),
    "a view twice": ([*names("from 0").values(), "scene_1_2.png"], {}),
    "two light fields": ([*names("from 0").values(), "other_00_00.png", "other_00_01.png"], {}),
    "numbers that are no square": (NUMBERED, {}),
    "numbers that are no square, although it is said": (NUMBERED, {"pattern": "index"}),
    "numbers beyond the grid": (NUMBERED, {"pattern": "index", "grid": (2, 2)}),
    "a grid of nothing": (NUMBERED, {"pattern": "index", "grid": (0, 8)}),
    "one row of 9 or 3x3 views": ([f"cam_1_{n:02d}.png" for n in range(1, 10)], {}),
    "billions of rows": (["a_0_0.png", "a_99999999_99999999.png"], {"pattern": r"_(?P<row>\d+)_(?P<column>\d+)"}),
    "billions of numbers": (["input_Cam0.png", "input_Cam99999999999.png"], {}),
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


def test_a_row_of_nine_and_a_square_of_nine_are_read_where_the_option_says_which(view_folder):
    folder = view_folder({(0, n): f"cam_1_{n + 1:02d}.png" for n in range(9)})
    assert read.read(folder, pattern="row_column").grid == (1, 9)
    assert read.read(folder, pattern="index").grid == (3, 3)


@pytest.mark.parametrize(
    ("naming", "foreign"),
    [("from 0", "preview.png"), ("from 0", "thumb_1_2.png"), ("HCI", "objectids_highres.png"), ("000", "depth.png")],
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


def test_numbered_pictures_count_only_if_they_are_small(view_folder, monkeypatch):
    folder = view_folder({(0, index): f"photo{index}.png" for index in range(9)})
    assert view_folders.is_field(folder)
    monkeypatch.setattr(view_folders, "LARGEST_NUMBERED", 2)
    assert not view_folders.is_field(folder)


@pytest.mark.parametrize(
    ("first", "last", "count", "expected"),
    [
        (0, 80, 81, (9, 0)),
        (7, 15, 9, (3, 7)),
        (1, 25, 9, (5, 1)),  # a cross, or a diagonal
        (0, 24, 9, (5, 0)),
        (2, 22, 5, (5, 0)),  # the upper and the lower end are missing
        (0, 7, 8, None),
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


def test_a_missing_view_is_read_where_that_is_allowed(view_folder):
    folder = view_folder({cell: name for cell, name in names("from 0").items() if cell != (1, 2)})
    field = read.read(folder, holes=True)
    assert field.weight.flatten(2).amax(2).tolist() == [[1, 1, 1], [1, 1, 0], [1, 1, 1]]
    turned = read.read(folder, holes=True, reverse_u=True)
    assert turned.weight.flatten(2).amax(2).tolist() == [[1, 1, 1], [0, 1, 1], [1, 1, 1]]


def test_alpha_of_views_is_the_weight(tmp_path):
    for row, column in GRID:
        images.write_image(tmp_path / f"a_{row}_{column}.png", np.full((2, 3, 4), (10, 20, 30, 40 + row), np.uint8))
    field = read.read(tmp_path, encoding="none")
    assert field.views.shape == (3, 3, 3, 2, 3)
    assert (field.weight[2] * 255).unique().tolist() == [42]
    assert (field.views[..., 1, :, :] * 255).unique().tolist() == [20]


@pytest.mark.parametrize(
    ("suffix", "space", "expected"),
    [
        ("png", "sRGB", "srgb"),
        ("png", "lin_rec709_scene", "linear"),
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


PIXEL = b"BM" + struct.pack("<IIIIiiHHIIiiIIB3x", 58, 0, 54, 40, 1, 1, 1, 24, 0, 4, 0, 0, 0, 0, 9)
"""A BMP of one pixel, which is written in no time."""
NAME = st.one_of(
    st.from_regex(r"\A[a-c]?_?[0-9]{1,4}[_x-]?[0-9]{0,4}\.png\Z"),
    st.from_regex(r"\A(v|u|row|c)[0-2]_?(u|v|t|s)?[0-2]?\.png\Z"),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(found=st.sets(NAME, max_size=12), holes=st.sampled_from([None, True, False]))
def test_no_names_end_in_a_traceback_or_a_grid_larger_than_its_views(tmp_path_factory, found, holes):
    folder = tmp_path_factory.mktemp("names")
    for name in found:
        (folder / name).write_bytes(PIXEL)
    try:
        colours = view_folders.decode_folder(folder, ReadOptions(holes=holes)).colours
    except LfrefError:
        return
    assert max(colours.shape[:2]) <= 4 * len(found)
