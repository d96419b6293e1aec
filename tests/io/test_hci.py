"""The benchmark of HCI: its sign of disparity on a scene photographed by pinholes, and its parameters."""

from pathlib import Path

import numpy as np
import pytest
import torch

from lfref.errors import FileError
from lfref.io import disparity_files, metadata, read
from lfref.refocus.shift.shift_and_sum import shift_and_sum

PARAMETERS = """[intrinsics]
focal_length_mm = 100.0
image_resolution_x_px = 512
image_resolution_y_px = 512
sensor_size_mm = 35.0
fstop = 100.0

[extrinsics]
num_cams_x = 9
num_cams_y = 9
baseline_mm = 25.0
focus_distance_m = 4.25

[meta]
scene = cotton
disp_min = -1.6
disp_max = 1.5
"""


def photographed(depth: float, focus: float, focal: float = 64.0, baseline: float = 0.25) -> tuple[torch.Tensor, float]:
    """Views of a textured wall by pinholes in a plane, and its disparity as HCI counts it.

    Camera (v, u) stands u baselines to the right of the middle one and v below it; each sensor is shifted so that
    points at the distance `focus` fall on the same pixel of all views. The texture has waves of whole periods.
    """
    rows = torch.arange(24, dtype=torch.float64)[:, None]
    columns = torch.arange(32, dtype=torch.float64)[None, :]
    offsets = torch.arange(5, dtype=torch.float64) - 2
    disparity = focal * baseline * (1 / depth - 1 / focus)  # near things: positive
    views = torch.empty(5, 5, 1, 24, 32, dtype=torch.float64)
    for v, down in enumerate(offsets):
        for u, right in enumerate(offsets):
            # A point of the wall at X is seen at focal (X - camera) / depth, and the sensor's shift is taken off.
            at_x = columns + focal * right * baseline / depth - focal * right * baseline / focus
            at_y = rows + focal * down * baseline / depth - focal * down * baseline / focus
            views[v, u, 0] = 0.5 + 0.2 * torch.sin(np.pi / 4 * at_x) + 0.2 * torch.cos(np.pi / 6 * at_y + 1)
    return views, disparity


@pytest.mark.parametrize(("depth", "focus"), [(4.0, 8.0), (8.0, 4.0), (5.0, 6.0)])
def test_their_disparity_with_our_sign_is_the_slope_that_is_sharp(tmp_path, depth, focus):
    views, disparity = photographed(depth, focus)
    assert (disparity > 0) == (depth < focus)
    disparity_files.write_pfm(tmp_path / "gt_disp_lowres.pfm", np.full((24, 32), disparity))
    slope = float(disparity_files.read_hci_disparity(tmp_path / "gt_disp_lowres.pfm")[0, 0])
    sharp, mirrored = shift_and_sum(views, [slope, -slope], interpolation="exact")[:, 0, 8:-8, 8:-8]
    truth = views[2, 2, 0, 8:-8, 8:-8]
    assert (sharp - truth).abs().max() < 0.02  # what wraps around at the borders
    assert (mirrored - truth).abs().max() > 0.1


def test_colours_are_no_disparity(tmp_path, one_line):
    disparity_files.write_pfm(tmp_path / "a.pfm", np.zeros((2, 3, 3)))
    with pytest.raises(FileError) as caught:
        disparity_files.read_hci_disparity(tmp_path / "a.pfm")
    one_line(caught.value, tmp_path / "a.pfm", "grey")


def test_parameters_are_metadata_and_the_range_has_our_sign(view_folder):
    folder = view_folder(
        {(row, column): f"input_Cam{3 * row + column:03d}.png" for row in range(3) for column in range(3)}
    )
    (folder / "parameters.cfg").write_text(PARAMETERS)
    said = read.read(folder).metadata
    assert said["slopes"] == "-1.5 1.6"
    assert (said["scene"], said["focal length"], said["baseline"]) == ("cotton", "100.0 mm", "25.0 mm")
    assert (said["f-number"], said["focus distance"], said["sensor size"]) == ("100.0", "4.25 m", "35.0 mm")


@pytest.mark.parametrize(
    "contents", ["", "x", "[meta]\ndisp_min = a\n", "[meta\n", PARAMETERS.replace("disp_max", "dispmax")]
)
def test_foreign_parameters_are_one_line_and_do_not_keep_views_from_being_read(view_folder, contents, one_line):
    folder: Path = view_folder({(0, column): f"a_0_{column}.png" for column in range(3)})
    (folder / "parameters.cfg").write_text(contents)
    with pytest.raises(FileError) as caught:
        metadata.hci_metadata(folder)
    one_line(caught.value, folder / "parameters.cfg")
    assert read.read(folder).grid == (1, 3)
