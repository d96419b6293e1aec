"""Result files, read back by other programs, hold the computed values; focus maps fade where confidence is low."""

import av
import numpy as np
import OpenImageIO
import pytest
import torch

import lfref
from lfref.geometry import FocalPlanes
from lfref.io.read import read_stack
from lfref.lightfield import LightField
from lfref.report import refocused as results
from lfref.report.refocused import Refocused
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.io.test_disparity_files import parsed


@pytest.fixture(scope="module")
def scene():
    """Cards at several depths, larger disparities nearer."""
    views = simulate(sim30.SCENES["shards"], 0, ("views",)).views
    planes = FocalPlanes([0.3, -1, -0.6])
    return Refocused(LightField(views, "shards"), lfref.shift_and_sum(views, planes.slopes), planes)


@pytest.fixture(scope="module")
def written(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "a folder"
    results.write_results(folder, scene, results.OPTIONAL)
    return folder


def pixels(path):
    return OpenImageIO.ImageBuf(str(path)).get_pixels("float")


def test_the_folder_holds_nothing_else(written):
    assert sorted(str(path.relative_to(written)) for path in written.rglob("*") if path.is_file()) == sorted([
        "stack.exr", "contact_sheet.png", "all_views_mean.png", "all_in_focus.png", "focus_map.png",
        "planes/plane_00_slope_0.3_alpha_1.429.png", "planes/plane_01_slope_-1_alpha_0.5.png",
        "planes/plane_02_slope_-0.6_alpha_0.625.png", "sweep.mp4", "points.ply",
        *(f"disparity/{name}.{suffix}" for name in ("disparity", "confidence") for suffix in ("pfm", "exr")),
        "disparity/confidence.png", "disparity/map.png",
    ])  # fmt: skip


def test_planes_are_the_stack(scene, written):
    stack, planes = read_stack(written / "stack.exr")
    assert torch.equal(stack, scene.stack)
    assert planes == scene.planes
    shown = pixels(written / "planes" / "plane_01_slope_-1_alpha_0.5.png")
    np.testing.assert_allclose(shown, scene.encoded(scene.stack[1]), atol=0.51 / 255)


def test_disparity_and_confidence_come_back(scene, written):
    for name, values in zip(("disparity", "confidence"), scene.disparity, strict=True):
        np.testing.assert_array_equal(pixels(written / "disparity" / f"{name}.exr")[..., 0], values)
    sure = pixels(written / "disparity" / "confidence.png")[..., 0]
    np.testing.assert_allclose(sure, scene.disparity.confidence, atol=0.51 / 65535)


def test_points_are_the_confident_pixels_in_their_colours_and_nearer_ones_in_front(scene, written):
    _, table = parsed(written / "points.ply")
    disparity, confidence = (values.numpy() for values in scene.disparity)
    sure = confidence > results.POINT_CONFIDENCE
    assert 0.3 * sure.size < len(table) == sure.sum() < sure.size
    rows, columns = np.nonzero(sure)
    np.testing.assert_allclose(table["x"], columns - 95.5)
    np.testing.assert_allclose(table["y"], 63.5 - rows)
    np.testing.assert_allclose(table["z"], 32 * disparity[sure], rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(table["disparity"], disparity[sure])
    middle = scene.encoded(scene.field.views[3, 3])[sure]
    colours = np.stack([table[name] for name in ("red", "green", "blue")], -1) / 255
    assert np.abs(colours - middle).mean() < 0.02


def test_the_sweep_goes_by_slope_there_and_back(scene, written):
    with av.open(str(written / "sweep.mp4")) as container:
        frames = [frame.reformat(format="rgb24", src_colorspace="ITU709") for frame in container.decode(video=0)]
    shown = [scene.encoded(scene.stack[n]) for n in (1, 2, 0, 2)]
    assert len(frames) == 4
    for frame, expected in zip(frames, shown, strict=True):
        errors = [np.abs(frame.to_ndarray() / 255 - scene.encoded(plane)).mean() for plane in scene.stack]
        assert np.abs(frame.to_ndarray() / 255 - expected).mean() == min(errors) < 0.02
