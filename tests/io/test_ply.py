"""Point clouds are parsed by hand, as the format's description says."""

from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import point_cloud

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


def test_a_cloud_without_points_is_a_file_without_points(tmp_path):
    point_cloud.write_points(tmp_path / "a.ply", np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    assert len(parsed(tmp_path / "a.ply")[1]) == 0


@pytest.mark.parametrize("name", ["a.obj", "a"])
def test_other_suffixes_are_refused(tmp_path, name, one_line):
    with pytest.raises(InputError) as caught:
        point_cloud.write_points(tmp_path / name, PLACES, COLOURS)
    one_line(caught.value, tmp_path / name, ".ply")


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
