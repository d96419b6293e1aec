"""Folders of views: names, arrangements on the grid, what files say of their encoding, and what is read."""

import itertools
import struct
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfref import encoding
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import images, read, view_folders, view_names
from lfref.io.samples import ReadOptions

FOLDER = Path("f")


def found(numbers, name="{}.png"):
    (field,) = view_names.fields_of(
        [FOLDER / name.format(number) for number in numbers], [view_names.compiled("index")]
    )
    return field


@pytest.mark.parametrize(("side", "first"), itertools.product((1, 2, 9, 17), (0, 1, 7)))
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


def picture(path, space=None, kind="uint8"):
    """A 4x4 picture that says so about itself."""
    spec = OpenImageIO.ImageSpec(4, 4, 3, kind)
    if space:
        spec.attribute("oiio:ColorSpace", space)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.full((4, 4, 3), 100, np.uint8) if kind == "uint8" else np.full((4, 4, 3), 0.5, "f4"))
    assert output.close()


@pytest.mark.parametrize(
    ("space", "said"), [("sRGB", "srgb"), ("lin_rec709_scene", "linear"), ("Gamma1.8", "gamma:1.8")]
)
def test_chunks_of_a_png_are_believed(tmp_path, space, said):
    folder = tmp_path / "field"
    folder.mkdir()
    for column in range(2):
        picture(folder / f"a_00_{column:02d}.png", space)
    assert str(view_folders.encoding_of(folder / "a_00_00.png", "file", encoding.NONE)) == said
    field = read.read(folder)
    assert field.metadata["encoding"] == said
    assert field.is_linear
    assert not read.read(folder, encoding="none").is_linear


def test_a_tiff_says_nothing_and_its_floating_point_numbers_are_light(tmp_path):
    folder = tmp_path / "field"
    folder.mkdir()
    for column in range(2):
        picture(folder / f"a_00_{column:02d}.tif", kind="float")
    assert view_folders.encoding_of(folder / "a_00_00.tif", "file", encoding.NONE) is encoding.NONE
    field = read.read(folder)
    assert field.metadata["encoding"] == "linear"
    assert field.views.unique().tolist() == [0.5]


PIXEL = b"BM" + struct.pack("<IIIIiiHHIIiiIIB3x", 58, 0, 54, 40, 1, 1, 1, 24, 0, 4, 0, 0, 0, 0, 9)
"""A BMP of one pixel, which is written in no time."""
GRID = [(row, column) for row in range(3) for column in range(3)]
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
    "NAME_RxC": lambda row, column: f"chess_{row}x{column}.png",
    "name that ends in a number": lambda row, column: f"IMG-2019-{row:02d}_{column:02d}.png",
    "every third": lambda row, column: f"s_{3 * row + 1:02d}_{3 * column + 1:02d}.png",
    "v and u": lambda row, column: f"v{row}_u{column}.png",
    "u and v": lambda row, column: f"scene_u{column:02d}v{row:02d}.png",
    "row and column": lambda row, column: f"my_row{row + 1}_col{column + 1}.png",
    "s and t": lambda row, column: f"S{column}_T{row}.png",
    "000": lambda row, column: f"{3 * row + column:03d}.png",
    "1": lambda row, column: f"{3 * row + column + 1}.png",
    "numbered through": lambda row, column: f"frame_{3 * row + column + 1:04d}.png",
    "numbered behind three digits": lambda row, column: f"seq_001_{3 * row + column:04d}.png",
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
    expected = {"path": str(folder), "format": "folder", "bits": "8", "encoding": "srgb"}
    assert (field.name, field.metadata) == ("field", expected)


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


@pytest.mark.parametrize("naming", [NAMINGS["HCI"], NAMINGS["from 1"]])
@pytest.mark.parametrize("cell", [(1, 1), (0, 1)])
def test_a_missing_view_is_named(view_folder, naming, cell, one_line):
    folder = view_folder(names(naming))
    (folder / naming(*cell)).unlink()
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, naming(*cell), "add the missing")


@pytest.mark.parametrize("count", [8, 10])
def test_row_major_names_must_be_a_square_number(view_folder, count, one_line):
    folder = view_folder({(0, index): f"input_Cam{index:03d}.png" for index in range(count)})
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, "square", f"got {count}", f"input_Cam{count:03d}.png")


def test_a_stray_name_of_billions_is_refused_at_once(view_folder):
    folder = view_folder({(0, 0): "a_00_00.png", (0, 1): "a_99999999_99999999.png"})
    assert read.read(folder).grid == (1, 1)  # no rows and columns have so many digits
    with pytest.raises(FileError, match="missing"):
        read.read(folder, pattern=r"_(?P<row>\d+)_(?P<column>\d+)")
    folder = view_folder({(0, 0): "input_Cam0.png", (0, 1): "input_Cam99999999999.png"}, "hci")
    with pytest.raises(FileError, match=r"no input_Cam1\.png"):
        read.read(folder)


@pytest.mark.parametrize("second", ["other_0{}_00.png", "input_Cam00{}.png", "out_00_0{}_1.0_2.0_.png"])
def test_two_light_fields_in_one_folder_are_refused_and_a_single_stray_name_is_not(view_folder, second, one_line):
    view_folder(names(NAMINGS["from 0"]))
    folder = view_folder({(0, 0): second.format(0)})
    assert read.read(folder).grid == (3, 3)
    view_folder({(0, 1): second.format(1)})
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, second.format(0), "scene_00_00.png", "reader.pattern")


@pytest.mark.parametrize(
    ("naming", "foreign"),
    [
        ("from 0", "preview.png"),
        ("from 0", "thumb_1_2.png"),
        ("from 0", "scene_03_03.png"),
        ("HCI", "input_Cam009.png"),
        ("000", "depth.png"),
        ("000", "009.png"),
        ("000", "view_1_1.png"),
    ],
)
def test_a_foreign_picture_is_left_out_and_named(view_folder, numbered_views, caplog, naming, foreign):
    folder = view_folder(names(NAMINGS[naming]))
    for name in ("Thumbs.db", "README", "README.txt"):
        (folder / name).write_bytes(b"x")
    with caplog.at_level("INFO", "lfref"):
        assert read.read(folder).grid == (3, 3)
    assert not caplog.messages
    images.write_image(folder / foreign, np.zeros((5, 4, 3)))
    assert view_folders.is_field(folder)
    with caplog.at_level("INFO", "lfref"):
        assert numbered_views(read.read(folder).views) == EXPECTED
    assert caplog.messages == [f"{folder}: left out, since they are no views: {foreign}"]


def test_a_picture_of_another_size_in_the_grid_is_still_an_error(view_folder, one_line):
    folder = view_folder(names(NAMINGS["from 0"]))
    images.write_image(folder / "scene_01_01.png", np.zeros((5, 4, 1)))
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, "scene_01_01.png must be 2x3", "got 5x4")


def test_the_log_names_five_pictures_that_are_left_out(view_folder, caplog):
    folder = view_folder({**names(NAMINGS["HCI"]), **{(0, 10 + k): f"gt_{'abcdefg'[k]}.png" for k in range(7)}})
    with caplog.at_level("INFO", "lfref"):
        read.read(folder)
    (message,) = caplog.messages
    assert message.endswith("gt_a.png, gt_b.png, gt_c.png, gt_d.png, gt_e.png and 2 more")


def test_the_encoding_is_that_of_a_view_and_not_of_a_picture_beside_it(tmp_path):
    for index in range(9):
        picture(tmp_path / f"view_{index // 3}_{index % 3}.png", "Gamma1.8")
    picture(tmp_path / "a_preview.png", "sRGB")
    assert read.read(tmp_path).metadata["encoding"] == "gamma:1.8"


def test_a_serpentine_path_turns_every_second_row(view_folder, numbered_views):
    folder = view_folder(
        {
            (row, column): f"{4 * row + (3 - column if row % 2 else column)}.png"
            for row in range(3)
            for column in range(4)
        }
    )
    expected = [[10 * row + column for column in range(4)] for row in range(3)]
    assert numbered_views(read.read(folder, pattern="serpentine", grid=(3, 4)).views) == expected
    (folder / "5.png").unlink()
    with pytest.raises(FileError, match=r"no 5\.png"):
        read.read(folder, pattern="serpentine", grid=(3, 4))


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
    field = read.read(tmp_path, encoding="none")
    assert field.views.shape == (3, 3, 3, 2, 3)
    assert field.weight.shape == (3, 3, 1, 2, 3)
    assert (field.weight[2] * 255).unique().tolist() == [42]
    assert (field.views[..., 1, :, :] * 255).unique().tolist() == [20]


def test_one_view_given_alone_is_not_taken_for_an_eslf(view_folder, one_line):
    folder = view_folder(names(NAMINGS["from 0"]))
    assert view_folders.is_view(folder / "scene_00_00.png")
    with pytest.raises(FileError) as caught:
        read.read(folder / "scene_00_00.png")
    one_line(caught.value, folder / "scene_00_00.png", f"read {folder}")


@pytest.mark.parametrize("suffix", ["tif", "jp2"])
def test_views_are_pictures_of_any_format(tmp_path, numbered_views, suffix):
    for row, column in GRID:
        path = tmp_path / f"{row}_{column}.{suffix}"
        output = OpenImageIO.ImageOutput.create(str(path))
        spec = OpenImageIO.ImageSpec(40, 40, 3, "uint8")
        spec.attribute("compression", "lossless" if suffix == "webp" else "none")
        assert output.open(str(path), spec)
        assert output.write_image(np.full((40, 40, 3), 10 * row + column, np.uint8))
        assert output.close()
    assert numbered_views(read.read(tmp_path).views) == EXPECTED


def test_a_grid_that_is_no_square_is_numbered_through_where_that_is_said(view_folder, numbered_views, one_line):
    folder = view_folder({(row, column): f"{3 * row + column}.png" for row in range(2) for column in range(3)})
    assert numbered_views(read.read(folder, pattern="index", grid=(2, 3)).views) == [[0, 1, 2], [10, 11, 12]]
    for options in ({"pattern": "index"}, {"pattern": "index", "grid": (2, 2)}, {"pattern": "index", "grid": (0, 6)}):
        with pytest.raises((FileError, InputError)) as caught:
            read.read(folder, **options)
        one_line(caught.value, folder, "reader.grid")


@pytest.mark.parametrize("count", [4, 8, 10, 100])
def test_numbered_pictures_that_may_be_anything_are_no_light_field(view_folder, count, one_line, monkeypatch):
    folder = view_folder({(0, index): f"photo{index}.png" for index in range(count)})
    # A hundred scenes make a square too, but not of small pictures.
    monkeypatch.setattr(view_folders, "LARGEST_NUMBERED", 2)
    assert not view_folders.is_field(folder)
    with pytest.raises(FileError) as caught:
        read.read(folder)
    one_line(caught.value, folder, f"got {count} images named like photo0.png", "set reader.pattern=index")


def test_a_row_of_views_is_told_from_a_square_that_is_numbered_through(view_folder, numbered_views, one_line):
    row = view_folder({(0, column): f"a_01_{column:02d}.png" for column in range(9)}, "row")
    assert numbered_views(read.read(row).views) == [list(range(9))]
    unclear = view_folder(names(lambda row, column: f"cam_1_{3 * row + column:02d}.png"), "unclear")
    with pytest.raises(FileError) as caught:
        read.read(unclear)
    one_line(caught.value, unclear, "reader.pattern=index", "reader.pattern=row_column")
    assert numbered_views(read.read(unclear, pattern="index").views) == EXPECTED
    assert read.read(unclear, pattern="row_column").grid == (1, 9)


def moved(folder: Path, shifts: list[tuple[float, float]]) -> Path:
    """Numbered pictures of a texture that moved by so many pixels down and to the right."""
    y, x = np.mgrid[:32, :48]
    for index, (down, right) in enumerate(shifts):
        wave = np.sin((y - down) / 7) + np.cos((x - right) / 9)
        images.write_image(folder / f"{index:03d}.png", (wave[..., None] + 2) / 4)
    return folder


def test_a_row_of_pictures_is_no_square_grid_only_for_its_number(tmp_path, one_line):
    grid_of_views = moved(tmp_path / "grid", [(row, column) for row in range(4) for column in range(4)])
    assert read.read(grid_of_views).grid == (4, 4)
    row = moved(tmp_path / "row", [(0, column) for column in range(16)])
    with pytest.raises(FileError) as caught:
        read.read(row)
    one_line(caught.value, row, "look like one row", "reader.grid=[1,16]")
    assert read.read(row, pattern="index", grid=(1, 16)).grid == (1, 16)
    assert read.read(row, pattern="index").grid == (4, 4)


CROSS = [(row, column) for row in range(5) for column in range(5) if row == 2 or column == 2]
DIAGONALS = [(row, column) for row in range(5) for column in range(5) if row in (column, 4 - column)]


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
    assert field.grid == (5, 5)
    numbers, weight = numbered_views(field.views), field.weight.flatten(2)
    for row in range(5):
        for column in range(5):
            if (row, column) in cells:
                assert numbers[row][column] == 10 * row + column
            assert weight[row, column].unique().tolist() == [float((row, column) in cells)]
    assert field.metadata["missing"] == "16 of 25 views"


def test_a_missing_view_is_read_where_that_is_allowed(view_folder, numbered_views):
    folder = view_folder({cell: NAMINGS["from 0"](*cell) for cell in GRID if cell != (1, 2)})
    field = read.read(folder, holes=True)
    assert field.metadata["missing"] == "1 of 9 views"
    assert field.weight.flatten(2).amax(2).tolist() == [[1, 1, 1], [1, 1, 0], [1, 1, 1]]
    assert numbered_views(field.views)[1][2] == round(
        np.mean([10 * row + column for row, column in GRID if (row, column) != (1, 2)])
    )
    turned = read.read(folder, holes=True, reverse_u=True)
    assert turned.weight.flatten(2).amax(2).tolist() == [[1, 1, 1], [0, 1, 1], [1, 1, 1]]


@pytest.mark.parametrize("name", ["out_{:02d}_{:02d}_{:.6f}_{:.6f}_", "Tarot_{:02d}_{:02d}_{:.2f}_{:.2f}_30_36"])
def test_a_gantry_says_where_its_cameras_stood(view_folder, name):
    said = {cell: (-3.0 * cell[0] + (cell == (1, 1)), 2.0 * cell[1]) for cell in GRID}
    folder = view_folder({cell: name.format(*cell, v, u) + ".png" for cell, (v, u) in said.items()})
    np.testing.assert_array_equal(
        view_folders.positions_in_names(folder, ReadOptions()),
        [[said[row, column] for column in range(3)] for row in range(3)],
    )
    window = view_folders.positions_in_names(folder, ReadOptions((2, 2), start=1))
    np.testing.assert_array_equal(window[0, 0], said[1, 1])
    stood = read.read(folder, positions="names").positions
    assert float(stood[1, 1, 0]) != float(stood[1, 0, 0])


def test_names_without_positions_are_refused_where_positions_are_asked_for(view_folder, one_line):
    with pytest.raises(FileError) as caught:
        view_folders.positions_in_names(view_folder(names(NAMINGS["HCI"])), ReadOptions())
    one_line(caught.value, "input_Cam000.png", "NAME_RR_CC_Y_X", "reader.positions")


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
        views = view_folders.decode_folder(folder, ReadOptions(holes=holes))
    except LfrefError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert max(views.shape[:2]) <= 4 * len(found)
