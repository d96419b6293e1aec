"""Points in space from disparity, and PLY files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from lfref.errors import FileError, InputError
from lfref.io import point_cloud
from lfref.io.point_cloud import Cameras

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
    point_cloud.write_points(
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
        point_cloud.write_points(tmp_path / "a.ply", places, colours, others)
    assert not list(tmp_path.iterdir())


def test_no_file_is_replaced(tmp_path, one_line):
    (tmp_path / "a.ply").write_text("mine")
    with pytest.raises(FileError) as caught:
        point_cloud.write_points(tmp_path / "a.ply", PLACES, COLOURS)
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
    places, pixels, unit = point_cloud.points(nearness, torch.ones(height, width), Cameras.from_metadata(HCI))
    expected = torch.stack([x, -rows[:, None] * depth / f, -depth], -1).reshape(-1, 3)
    torch.testing.assert_close(places, expected.float())
    assert pixels.all()
    assert unit == "unit: metre"


def test_points_of_a_corner_stand_where_those_of_the_whole_do():
    nearness = torch.rand(40, 60, generator=torch.Generator().manual_seed(2))
    whole = point_cloud.points(nearness, torch.ones(40, 60), Cameras.from_metadata(HCI)).positions.reshape(40, 60, 3)
    cut = HCI | {"cut from": "40x60 pixels"}
    corner = point_cloud.points(nearness[:20, :35], torch.ones(20, 35), Cameras.from_metadata(cut)).positions
    torch.testing.assert_close(corner, whole[:20, :35].reshape(-1, 3))


def test_without_cameras_points_stand_at_their_pixels_and_nearer_ones_in_front():
    nearness = torch.tensor([[0.0, 1.0, -2.0], [0.5, 0.0, torch.nan]])
    chosen = torch.tensor([[True, True, True], [False, True, True]])
    places, pixels, unit = point_cloud.points(nearness, chosen)
    scale = 0.25 * 2
    assert places.tolist() == [[-1, 0.5, 0], [0, 0.5, scale], [1, 0.5, -2 * scale], [0, -0.5, 0]]
    assert pixels.tolist() == [[True, True, True], [False, True, False]]
    assert "0.5 times the nearness" in unit


def test_what_is_beyond_infinity_is_left_out():
    nearness = torch.tensor([[0.0, -2.0, -100.0]])  # the horizon has about -1.93
    places, pixels, _ = point_cloud.points(nearness, torch.ones(1, 3), Cameras(100 / 35, 0.09, 0.4))
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
