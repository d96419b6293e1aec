"""`lfref refocus`: a folder of results for each light field, with what was asked for in it."""

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.io.read import read_stack
from lfref.io.write import write
from lfref.lightfield import LightField
from tests.cli.test_bad_input import assert_one_line

QUICK = ("method=shift_and_sum", "slopes=[-0.5,0.5]")


@pytest.fixture
def captures(tmp_path):
    """A folder of three light fields, one of which cannot be read."""
    for name in ("first one", "second", "third"):
        write(tmp_path / "captures" / name, LightField(torch.rand(3, 3, 3, 32, 40)))
    view = tmp_path / "captures" / "second" / "second_01_01.png"
    view.write_bytes(view.read_bytes()[:-30])
    return tmp_path / "captures"


def test_one_bad_capture_does_not_stop_the_others(lfref, captures, tmp_path):
    status, error = lfref("refocus", captures, f"output={tmp_path}/out", *QUICK)
    assert status == 1
    assert "all 3 light fields must be usable; got 1 that failed: second" in error.replace("\n", " ")
    assert "second_01_01.png" in (tmp_path / "out" / "refocus.log").read_text()
    assert "Traceback" not in error
    for name in ("first one", "third"):
        assert read_stack(tmp_path / "out" / name / "stack.exr")[0].shape == (2, 3, 32, 40)
    assert not (tmp_path / "out" / "second").exists()


def test_a_folder_of_one_capture_gets_a_folder_too(lfref, tmp_path):
    write(tmp_path / "captures" / "only", LightField(torch.rand(3, 3, 3, 32, 40)))
    assert lfref("refocus", tmp_path / "captures", f"output={tmp_path}/out", *QUICK)[0] == 0
    assert (tmp_path / "out" / "only" / "stack.exr").exists()


def test_a_capture_given_twice_is_refocused_once_in_the_run_folder(lfref, captures, tmp_path):
    given = captures / "first one"
    assert lfref("refocus", given, given, f"output={tmp_path}/out", *QUICK)[0] == 0
    assert (tmp_path / "out" / "stack.exr").exists()
    assert not (tmp_path / "out" / "first one").exists()


def test_pictures_of_16_bits_and_jpegs(lfref, captures, tmp_path):
    words = ("refocus", captures / "third", *QUICK, "exposure=1")
    assert lfref(*words, "bits=16", f"output={tmp_path}/deep")[0] == 0
    plane = OpenImageIO.ImageBuf(str(tmp_path / "deep" / "planes" / "plane_00_slope_-0.5_alpha_0.6667.png"))
    assert str(plane.spec().format) == "uint16"
    levels = 255 * plane.get_pixels("float")
    assert levels.shape == (32, 40, 3)
    assert (abs(levels - np.rint(levels)) > 0.1).mean() > 0.7
    assert lfref(*words, "format=jpg", "quality=70", f"output={tmp_path}/small")[0] == 0
    assert (tmp_path / "small" / "planes" / "plane_01_slope_0.5_alpha_2.jpg").exists()
    assert (tmp_path / "small" / "all_views_mean.jpg").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("format=bmp",), "format must be one of png, jpg"),
        (("format=jpg", "bits=16"), "bits of jpg must be 8"),
        (("bits=12",), "bits of png must be 8 or 16"),
        (("quality=0",), "quality must be a number"),
        (("quality=101",), "quality must be"),
        (("points=perhaps",), "points must be true or false"),
    ],
)
def test_pictures_that_cannot_be_written_are_refused_before_any_work(lfref, captures, tmp_path, words, said):
    line = assert_one_line(*lfref("refocus", captures / "third", f"output={tmp_path}/out", *words))
    assert said in line
    assert not (tmp_path / "out" / "stack.exr").exists()


def test_a_flat_wall_has_no_points_and_all_else(lfref, tmp_path):
    wall = write(tmp_path / "a wall", LightField(torch.full((3, 3, 3, 32, 40), 0.5)))
    words = ("points=true", "video=true", "disparity=true", "all_in_focus=true")
    status, error = lfref("refocus", wall, f"output={tmp_path}/out", *QUICK, *words)
    assert status == 1
    assert "a wall must show something whose distance can be told" in error
    assert {"sweep.mp4", "sweep.gif", "focus_map.png", "disparity"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }


@pytest.mark.slow
def test_what_people_take_away_from_the_real_capture(lfref, lytro, tmp_path):
    words = ("points=true", "video=true", "disparity=true", "planes=even", "planes.first=-1.2", "planes.last=0.3")
    assert lfref("refocus", lytro, f"output={tmp_path}/out", *words, "planes.n=4", "reader.views=7")[0] == 0
    _, _, data = (tmp_path / "out" / "points.ply").read_bytes().partition(b"end_header\n")
    fields = [*((axis, "<f4") for axis in "xyz"), ("colour", "u1", 3), ("disparity", "<f4"), ("confidence", "<f4")]
    points = np.frombuffer(data, fields)
    assert len(points) > 0.5 * 383 * 552
    # The head of the animal stands before the wall, though its disparity is smaller.
    head = points[(abs(points["x"] + 120) < 30) & (abs(points["y"] + 20) < 10)]
    wall = points[(abs(points["x"] + 120) < 30) & (abs(points["y"] - 130) < 30)]
    assert np.median(head["z"]) > np.median(wall["z"]) + 50
    assert np.median(head["disparity"]) < np.median(wall["disparity"]) - 0.5
