"""Points in space from disparity, PLY and PFM files, and HCI's benchmark: its sign of disparity and its parameters."""

from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lfref.io import disparity_files, read
from lfref.io.disparity_files import Cameras
from lfref.io.read import read_metadata
from lfref.refocus.fourier.exact import exact_fourier

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


def test_points_come_back_with_colours_and_other_properties(tmp_path):
    others = {"confidence": np.array([0.25, 1])}
    disparity_files.write_points(tmp_path / "a.ply", PLACES, COLOURS, others, ["unit: metre"])
    comments, table = parsed(tmp_path / "a.ply")
    assert comments == ["written by lfref", "unit: metre"]
    np.testing.assert_array_equal(np.stack([table[axis] for axis in "xyz"], -1), PLACES.astype(np.float32))
    np.testing.assert_array_equal(np.stack([table[name] for name in ("red", "green", "blue")], -1), COLOURS)
    assert table["confidence"].tolist() == [0.25, 1]


HCI = {"focal length": "100.0 mm", "sensor size": "35 mm", "baseline": "90.0 mm", "focus distance": "8.0 m"}


def test_points_that_cameras_saw_come_back_in_metres():
    height, width, baseline, focus, f = 40, 60, 0.09, 8.0, 100 / 35 * 60
    depth = 5 + 5 * torch.rand(height, width, dtype=torch.float64)
    rows, columns = torch.arange(height) - (height - 1) / 2, torch.arange(width) - (width - 1) / 2
    # How far the picture of each point moves from a camera to its neighbour, less that of a point at the focus.
    x = columns * depth / f
    nearness = f * (x / depth - (x - baseline) / depth) - f * baseline / focus
    places, pixels, unit = disparity_files.points(nearness, torch.ones(height, width), Cameras.from_metadata(HCI))
    expected = torch.stack([x, -rows[:, None] * depth / f, -depth], -1)
    torch.testing.assert_close(places, expected.reshape(-1, 3).float())
    assert pixels.all()
    assert unit == "unit: metre"
    # Points of a corner stand where those of the whole picture do.
    cut = Cameras.from_metadata(HCI | {"cut from": "40x60 pixels"})
    corner = disparity_files.points(nearness[:20, :35], torch.ones(20, 35), cut).positions
    torch.testing.assert_close(corner, expected[:20, :35].reshape(-1, 3).float())


def test_without_cameras_points_stand_at_their_pixels_and_nearer_ones_in_front():
    nearness = torch.tensor([[0.0, 1.0, -2.0], [0.5, 0.0, torch.nan]])
    chosen = torch.tensor([[True, True, True], [False, True, True]])
    places, pixels, _ = disparity_files.points(nearness, chosen)
    beyond_infinity = torch.tensor([[0.0, -2.0]])  # the horizon has about -1.93
    assert disparity_files.points(beyond_infinity, torch.ones(1, 2), Cameras(100 / 35, 0.09, 0.4)).pixels.sum() == 1
    scale = 0.25 * 2
    assert places.tolist() == [[-1, 0.5, 0], [0, 0.5, scale], [1, 0.5, -2 * scale], [0, -0.5, 0]]
    assert pixels.tolist() == [[True, True, True], [False, True, False]]


@pytest.mark.parametrize("metadata", [{}, HCI | {"baseline": "0 mm"}, HCI | {"baseline": "9 cm"}])
def test_cameras_that_are_not_known_are_none(metadata):
    assert Cameras.from_metadata(metadata) is None


SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 6), st.sampled_from([1, 3]))


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=arrays.arrays(np.float32, SHAPES, elements=st.floats(-1e6, 1e6, width=32, allow_subnormal=False)))
def test_another_library_reads_a_written_map_from_its_bottom_row(tmp_path: Path, values):
    path = tmp_path / f"{values.shape}{values.tobytes()[:8].hex()}.pfm"  # the library keeps what it has read
    disparity_files.write_pfm(path, values)
    np.testing.assert_array_equal(OpenImageIO.ImageBuf(str(path)).get_pixels("float")[::-1], values)


def photographed(depth: float, focus: float, focal: float = 64.0, baseline: float = 0.25) -> tuple[torch.Tensor, float]:
    """Views of a textured wall by pinholes in a plane, all focused on one distance; its disparity as HCI counts it."""
    rows, columns = torch.arange(24, dtype=torch.float64)[:, None], torch.arange(32, dtype=torch.float64)
    disparity = focal * baseline * (1 / depth - 1 / focus)  # near things: positive
    views = torch.empty(5, 5, 1, 24, 32, dtype=torch.float64)
    for v, u in np.ndindex(5, 5):
        # A point of the wall at X is seen at focal (X - camera) / depth, and the sensor's shift is taken off.
        at_x = columns + focal * (u - 2) * baseline / depth - focal * (u - 2) * baseline / focus
        at_y = rows + focal * (v - 2) * baseline / depth - focal * (v - 2) * baseline / focus
        views[v, u, 0] = 0.5 + 0.2 * torch.sin(np.pi / 4 * at_x) + 0.2 * torch.cos(np.pi / 6 * at_y + 1)
    return views, disparity


@pytest.mark.parametrize(("depth", "focus"), [(4.0, 8.0), (8.0, 4.0)])
def test_the_disparity_of_hci_with_our_sign_is_the_slope_that_is_sharp(tmp_path, depth, focus):
    views, disparity = photographed(depth, focus)
    assert (disparity > 0) == (depth < focus)
    disparity_files.write_pfm(tmp_path / "gt_disp_lowres.pfm", np.full((24, 32), disparity))
    # The lines of docs/captures.md.
    stored = OpenImageIO.ImageBuf(str(tmp_path / "gt_disp_lowres.pfm")).get_pixels("float")
    slope = float(-stored[::-1, :, 0][0, 0])
    sharp, mirrored = exact_fourier(views, [slope, -slope])[:, 0, 8:-8, 8:-8]
    truth = views[2, 2, 0, 8:-8, 8:-8]
    assert (sharp - truth).abs().max() < 0.02  # what wraps around at the borders
    assert (mirrored - truth).abs().max() > 0.1


PARAMETERS = """[intrinsics]
focal_length_mm = 100.0
sensor_size_mm = 35.0
fstop = 100.0
[extrinsics]
baseline_mm = 25.0
focus_distance_m = 4.25
[meta]
scene = cotton
disp_min = -1.6
disp_max = 1.5
"""


def test_parameters_of_hci_are_metadata_and_the_range_has_our_sign(view_folder):
    folder = view_folder({cell: f"input_Cam{3 * cell[0] + cell[1]:03d}.png" for cell in np.ndindex(3, 3)})
    (folder / "parameters.cfg").write_text(PARAMETERS)
    entries = read.read(folder).metadata
    assert entries["slopes"] == "-1.5 1.6"
    assert (entries["scene"], entries["focal length"], entries["baseline"]) == ("cotton", "100.0 mm", "25.0 mm")
    assert (entries["f-number"], entries["focus distance"], entries["sensor size"]) == ("100.0", "4.25 m", "35.0 mm")
    (folder / "parameters.cfg").write_text("[meta\n")
    assert read_metadata(folder) == {}
