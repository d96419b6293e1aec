"""Points in space from disparity, and PLY files."""

import struct
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lfref.errors import FileError, InputError
from lfref.io import disparity_files
from lfref.io.disparity_files import Cameras

PLACES = np.array([[0, 0.5, -1], [3, 4, 5.25]])
COLOURS = np.array([[255, 0, 7], [1, 2, 3]], np.uint8)


def parsed(path: Path) -> tuple[list[str], np.ndarray]:
    """Comments and vertices of a binary little-endian file of vertices only."""
    header, _, data = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    (count,) = [int(line.split()[2]) for line in lines if line.startswith("element vertex")]
    types = {"float": "<f4", "uchar": "u1"}
    fields = [(name, types[kind]) for _, kind, name in (line.split() for line in lines if line.startswith("property"))]
    assert len(data) == count * np.dtype(fields).itemsize
    return [line.removeprefix("comment ") for line in lines if line.startswith("comment")], np.frombuffer(data, fields)


def test_points_come_back_with_colours_and_whatever_else_is_known(tmp_path):
    disparity_files.write_points(
        tmp_path / "a.ply", PLACES, COLOURS, {"confidence": np.array([0.25, 1])}, ["unit: metre", "two\nlines"]
    )
    comments, table = parsed(tmp_path / "a.ply")
    assert comments == ["written by lfref", "unit: metre", "two lines"]
    np.testing.assert_array_equal(np.stack([table[axis] for axis in "xyz"], -1), PLACES.astype(np.float32))
    np.testing.assert_array_equal(np.stack([table[name] for name in ("red", "green", "blue")], -1), COLOURS)
    assert table["confidence"].tolist() == [0.25, 1]


@pytest.mark.parametrize(
    ("places", "colours", "others"),
    [
        (PLACES, COLOURS[:1], {}),
        (PLACES, COLOURS, {"confidence": np.zeros(3)}),
        (np.full((2, 3), np.nan), COLOURS, {}),
        (PLACES, COLOURS, {"confidence": np.array([0, np.inf])}),
    ],
)
def test_points_that_fit_nothing_are_refused(tmp_path, places, colours, others):
    with pytest.raises(InputError):
        disparity_files.write_points(tmp_path / "a.ply", places, colours, others)
    assert not list(tmp_path.iterdir())


def test_no_file_is_replaced(tmp_path, one_line):
    (tmp_path / "a.ply").write_text("mine")
    with pytest.raises(FileError) as caught:
        disparity_files.write_points(tmp_path / "a.ply", PLACES, COLOURS)
    one_line(caught.value, tmp_path / "a.ply", "choose another name")
    assert (tmp_path / "a.ply").read_text() == "mine"


HCI = {"focal length": "100.0 mm", "sensor size": "35 mm", "baseline": "90.0 mm", "focus distance": "8.0 m"}


def test_points_that_cameras_saw_come_back_in_metres():
    height, width, baseline, focus, f = 40, 60, 0.09, 8.0, 100 / 35 * 60
    generator = torch.Generator().manual_seed(1)
    depth = 5 + 5 * torch.rand(height, width, generator=generator, dtype=torch.float64)
    rows, columns = torch.arange(height) - (height - 1) / 2, torch.arange(width) - (width - 1) / 2
    # How far the picture of each point moves from a camera to its neighbour, less that of a point at the focus.
    x = columns * depth / f
    nearness = f * (x / depth - (x - baseline) / depth) - f * baseline / focus
    places, pixels, unit = disparity_files.points(nearness, torch.ones(height, width), Cameras.from_metadata(HCI))
    expected = torch.stack([x, -rows[:, None] * depth / f, -depth], -1).reshape(-1, 3)
    torch.testing.assert_close(places, expected.float())
    assert pixels.all()
    assert unit == "unit: metre"


def test_points_of_a_corner_stand_where_those_of_the_whole_do():
    nearness = torch.rand(40, 60, generator=torch.Generator().manual_seed(2))
    whole = disparity_files.points(nearness, torch.ones(40, 60), Cameras.from_metadata(HCI)).positions.reshape(
        40, 60, 3
    )
    cut = HCI | {"cut from": "40x60 pixels"}
    corner = disparity_files.points(nearness[:20, :35], torch.ones(20, 35), Cameras.from_metadata(cut)).positions
    torch.testing.assert_close(corner, whole[:20, :35].reshape(-1, 3))


def test_without_cameras_points_stand_at_their_pixels_and_nearer_ones_in_front():
    nearness = torch.tensor([[0.0, 1.0, -2.0], [0.5, 0.0, torch.nan]])
    chosen = torch.tensor([[True, True, True], [False, True, True]])
    places, pixels, unit = disparity_files.points(nearness, chosen)
    scale = 0.25 * 2
    assert places.tolist() == [[-1, 0.5, 0], [0, 0.5, scale], [1, 0.5, -2 * scale], [0, -0.5, 0]]
    assert pixels.tolist() == [[True, True, True], [False, True, False]]
    assert "0.5 times the nearness" in unit


def test_what_is_beyond_infinity_is_left_out():
    nearness = torch.tensor([[0.0, -2.0, -100.0]])  # the horizon has about -1.93
    places, pixels, _ = disparity_files.points(nearness, torch.ones(1, 3), Cameras(100 / 35, 0.09, 0.4))
    assert pixels.tolist() == [[True, False, False]]
    assert places[0, 2] == pytest.approx(-0.4)


@pytest.mark.parametrize(
    "changed",
    [
        {"baseline": "0 mm"},
        {"baseline": "9 cm"},
        {"focal length": "far"},
        {"sensor size": "-1"},
        {"focus distance": "inf"},
    ],
)
def test_cameras_that_are_not_known_are_none(changed):
    assert Cameras.from_metadata(HCI) is not None
    assert Cameras.from_metadata(HCI | changed) is None
    assert Cameras.from_metadata({}) is None


SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 6), st.sampled_from([1, 3]))


def test_a_file_packed_by_hand_is_read_from_its_bottom_row(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n3 2\n-1.0\n" + struct.pack("<6f", 4, 5, 6, 1, 2, 3))
    assert disparity_files.read_pfm(path)[..., 0].tolist() == [[1, 2, 3], [4, 5, 6]]
    path.write_bytes(b"Pf 3 2 1\n" + struct.pack(">6f", 4, 5, 6, 1, 2, 3))
    assert disparity_files.read_pfm(path)[..., 0].tolist() == [[1, 2, 3], [4, 5, 6]]


def test_a_missing_file_is_one_line(tmp_path, one_line):
    with pytest.raises(FileError) as caught:
        disparity_files.read_pfm(tmp_path / "a.pfm")
    one_line(caught.value, tmp_path / "a.pfm", "cannot be read;")


def test_data_that_starts_like_white_space_stay_data(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n1 1\n-1.0\n" + b"\n \t\r")
    assert disparity_files.read_pfm(path).tobytes() == b"\n \t\r"


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=arrays.arrays(np.float32, SHAPES, elements=st.floats(-1e6, 1e6, width=32, allow_subnormal=False)))
def test_what_is_written_comes_back_and_another_library_reads_the_same(tmp_path: Path, values):
    path = tmp_path / "a.pfm"
    disparity_files.write_pfm(path, values)
    np.testing.assert_array_equal(disparity_files.read_pfm(path), values)
    hints = OpenImageIO.ImageSpec()
    hints.attribute("pnm:pfmflip", 1)
    source = OpenImageIO.ImageInput.open(str(path), hints)
    np.testing.assert_array_equal(source.read_image(0, 0, 0, values.shape[2], "float"), values)
    source.close()


def test_infinity_of_others_is_kept_and_of_ours_is_refused(tmp_path, one_line):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n1 1\n-1\n" + struct.pack("<f", np.inf))
    assert np.isposinf(disparity_files.read_pfm(path)).all()
    for value in (np.nan, np.inf):
        with pytest.raises(InputError) as caught:
            disparity_files.write_pfm(tmp_path / "b.pfm", np.full((2, 2), value))
        one_line(caught.value, "b.pfm", "finite")
    assert not (tmp_path / "b.pfm").exists()


def test_every_truncation_and_every_excess_is_found(tmp_path, one_line):
    path = tmp_path / "a.pfm"
    disparity_files.write_pfm(path, np.ones((3, 4)))
    whole = path.read_bytes()
    for contents in (*(whole[:cut] for cut in range(len(whole))), whole + b"\0"):
        path.write_bytes(contents)
        with pytest.raises(FileError) as caught:
            disparity_files.read_pfm(path)
        one_line(caught.value, path, "copy")


@pytest.mark.parametrize("shape", [(2,), (2, 2, 2), (0, 3), (1, 2, 3, 1)])
def test_shapes_that_no_picture_has_are_refused(tmp_path, shape, one_line):
    with pytest.raises(InputError) as caught:
        disparity_files.write_pfm(tmp_path / "a.pfm", np.zeros(shape))
    one_line(caught.value, "a.pfm", shape)


def test_only_a_file_of_ours_is_replaced(tmp_path, one_line):
    path = tmp_path / "a.pfm"
    disparity_files.write_pfm(path, np.zeros((2, 2)))
    disparity_files.write_pfm(path, np.ones((2, 2)))
    assert disparity_files.read_pfm(path).min() == 1
    for theirs in (b"Pf\n1 1\n-1.0\n\0\0\0\0", b"a note"):
        path.write_bytes(theirs)
        with pytest.raises(FileError) as caught:
            disparity_files.write_pfm(path, np.ones((2, 2)))
        one_line(caught.value, path, "another file")
        assert path.read_bytes() == theirs
