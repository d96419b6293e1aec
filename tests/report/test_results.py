"""Result files, read back by other programs, hold the computed values; focus maps fade where confidence is low."""

import base64

import av
import numpy as np
import OpenImageIO
import pytest
import torch

import lfref
from lfref.errors import FileError, InputError
from lfref.geometry import FocalPlanes
from lfref.io.read import read_stack
from lfref.lightfield import LightField
from lfref.report import disparity_colours, pictures, results
from lfref.report.refocused import Refocused
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from lfref.viewer import view_page
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


def test_the_map_is_that_of_the_page(scene, written):
    np.testing.assert_allclose(pixels(written / "disparity" / "map.png"), scene.disparity_picture, atol=0.51 / 255)
    encoded = base64.b64decode(view_page.page_content({"a": scene})["map"].partition(",")[2])
    (written.parent / "page.jpg").write_bytes(encoded)
    differences = np.abs(pixels(written.parent / "page.jpg") - scene.disparity_picture)
    assert differences.mean() < 0.02  # what JPEG changes


def test_planes_are_the_stack(scene, written):
    stack, planes = read_stack(written / "stack.exr")
    assert torch.equal(stack, scene.stack)
    assert planes == scene.planes
    shown = pixels(written / "planes" / "plane_01_slope_-1_alpha_0.5.png")
    np.testing.assert_allclose(shown, scene.encoded(scene.stack[1]), atol=0.51 / 255)


def test_disparity_and_confidence_come_back(scene, written):
    for name, values in zip(("disparity", "confidence"), scene.disparity, strict=True):
        contents = (written / "disparity" / f"{name}.pfm").read_bytes()
        kind, size, scale, data = contents.split(b"\n", 3)
        assert (kind, size) == (b"Pf", b"192 128")
        assert float(scale) < 0
        np.testing.assert_array_equal(np.frombuffer(data, "<f4").reshape(128, 192)[::-1], values)
        np.testing.assert_array_equal(pixels(written / "disparity" / f"{name}.exr")[..., 0], values)
    sure = pixels(written / "disparity" / "confidence.png")[..., 0]
    np.testing.assert_allclose(sure, scene.disparity.confidence, atol=0.51 / 65535)


def test_points_are_the_confident_pixels_in_their_colours_and_nearer_ones_in_front(scene, written):
    comments, table = parsed(written / "points.ply")
    disparity, confidence = (values.numpy() for values in scene.disparity)
    sure = confidence > results.POINT_CONFIDENCE
    assert 0.3 * sure.size < len(table) == sure.sum() < sure.size
    rows, columns = np.nonzero(sure)
    np.testing.assert_allclose(table["x"], columns - 95.5)
    np.testing.assert_allclose(table["y"], 63.5 - rows)
    np.testing.assert_allclose(table["z"], 32 * disparity[sure], rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(table["disparity"], disparity[sure])
    assert "unit: pixel" in comments[1]
    middle = scene.encoded(scene.field.views[3, 3])[sure]
    colours = np.stack([table[name] for name in ("red", "green", "blue")], -1) / 255
    assert np.abs(colours - middle).mean() < 0.02


def test_points_of_known_cameras_are_in_metres(scene, tmp_path):
    cameras = {"focal length": "50 mm", "sensor size": "25 mm", "baseline": "10 mm", "focus distance": "2 m"}
    field = LightField(scene.field.views, "metric", metadata=cameras)
    refocused = Refocused(field, scene.stack, scene.planes)
    results.OPTIONAL["points"](tmp_path, refocused)
    comments, table = parsed(tmp_path / "points.ply")
    assert "unit: metre" in comments
    depth = 1 / (1 / 2 + table["disparity"].astype(np.float64) / (0.01 * 2 * 192))
    np.testing.assert_allclose(table["z"], -depth, rtol=1e-5)


def test_the_sweep_goes_by_slope_there_and_back(scene, written):
    with av.open(str(written / "sweep.mp4")) as container:
        frames = [frame.reformat(format="rgb24", src_colorspace="ITU709") for frame in container.decode(video=0)]
    shown = [scene.encoded(scene.stack[n]) for n in (1, 2, 0, 2)]
    assert len(frames) == 4
    for frame, expected in zip(frames, shown, strict=True):
        errors = [np.abs(frame.to_ndarray() / 255 - scene.encoded(plane)).mean() for plane in scene.stack]
        assert np.abs(frame.to_ndarray() / 255 - expected).mean() == min(errors) < 0.02


def test_a_flat_scene_has_no_point_and_all_else_is_written(tmp_path):
    views = torch.full((3, 3, 3, 32, 40), 0.5)
    refocused = Refocused(LightField(views, "wall"), views[:1, 0], FocalPlanes([0]))
    with pytest.raises(InputError, match="wall must have pixels of confident disparity"):
        results.write_results(tmp_path, refocused, results.OPTIONAL)
    assert (tmp_path / "disparity" / "map.png").exists()
    assert (tmp_path / "sweep.mp4").exists()
    assert not (tmp_path / "points.ply").exists()


def test_a_folder_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("x")
    views = torch.rand(3, 3, 3, 32, 40)[:1, :1].expand(3, 3, -1, -1, -1)
    refocused = Refocused(LightField(views, "a"), views[:1, 0], FocalPlanes([0]))
    for result in (*results.ALWAYS.values(), *results.OPTIONAL.values()):
        with pytest.raises(FileError, match="choose another"):
            result(tmp_path / "file", refocused)


@pytest.mark.parametrize("most", [1.0, 0.4, 0.1])
def test_colour_is_the_slope_and_opacity_the_confidence_beside_that_of_most(most):
    slopes = torch.linspace(-1, 0.5, 21).reshape(3, 7)
    confidence = torch.linspace(0, most, 21).reshape(3, 7)
    sheet = results.focus_map(slopes, confidence)
    opaque = max(0.9 * most, 0.25)
    opacity = (confidence / opaque).clamp(max=1).numpy()
    low, high = results.colour_range(slopes.double().numpy(), opacity)
    colours = disparity_colours.coloured(slopes.numpy(), low, high)
    expected = 255 * (opacity[..., None] * colours + 1 - opacity[..., None])
    height, width = sheet.shape[0] - 3 * pictures.SHEET_LINE, pictures.MAP_WIDTH
    middles = np.ix_(((np.arange(3) + 0.5) * height / 3).astype(int), ((np.arange(7) + 0.5) * width / 7).astype(int))
    drawn = sheet[pictures.SHEET_LINE :, pictures.SHEET_GAP :][middles]
    np.testing.assert_allclose(drawn, expected, atol=0.51)
    bar = sheet[
        pictures.SHEET_LINE : pictures.SHEET_LINE + height, 2 * pictures.SHEET_GAP + width + pictures.BAR_WIDTH // 2
    ]
    np.testing.assert_allclose(bar[[0, -1]] / 255, disparity_colours.coloured(np.array([[1, 0]]), 0, 1)[0], atol=0.01)


def test_a_few_outliers_do_not_stretch_the_scale_however_sure_they_are():
    slopes = torch.linspace(-1, 1, 1000).reshape(20, 50)
    confidence = torch.full((20, 50), 0.6)
    slopes[0, :10], confidence[0, :10] = 40, 0.99
    low, high = results.colour_range(slopes.numpy(), confidence.numpy())
    assert -1 < low < -0.9
    assert 0.9 < high < 1.1


def test_pixels_of_low_confidence_hardly_count():
    slopes = torch.linspace(-1, 1, 1000).reshape(20, 50)
    slopes[:2] = 5
    confidence = torch.full((20, 50), 0.9)
    confidence[:2] = 0.12
    assert results.colour_range(slopes.numpy(), confidence.numpy())[1] < 1.1
