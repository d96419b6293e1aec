"""`lfref refocus`: a folder of results for each light field, with what was asked for in it."""

import shutil

import numpy as np
import OpenImageIO
import torch

from lfref.io.read import read_stack
from lfref.io.write import write
from lfref.lightfield import LightField

QUICK = ("method=shift_and_sum", "slopes=[-0.5,0.5]")


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


def contents(folder):
    """Results of all light fields by name; an EXR file, which says when it was written, by its stack."""
    files = (path for path in folder.glob("*/**/*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): read_stack(path)[0].numpy().tobytes()
        if path.suffix == ".exr"
        else path.read_bytes()
        for path in files
    }


def test_a_run_that_was_killed_goes_on_and_leaves_the_same_files(lfref, tmp_path):
    for n in range(3):
        write(tmp_path / "captures" / f"c_{n}", LightField(torch.rand(3, 3, 3, 32, 40)))
    out = tmp_path / "out"
    assert lfref("refocus", tmp_path / "captures", f"output={out}", *QUICK)[0] == 0
    whole, time_ns = contents(out), (out / "c_0").stat().st_mtime_ns
    for name in ("c_1", "c_2"):
        shutil.rmtree(out / name)
    (out / ".c_2.partial-123456789abc").mkdir()
    (out / ".c_2.partial-123456789abc" / "stack.exr").write_bytes(b"half of it")
    status, error = lfref("refocus", f"resume={out}")
    assert status == 0, error
    assert contents(out) == whole
    assert (out / "c_0").stat().st_mtime_ns == time_ns


def test_a_sweep_of_inputs_that_is_given_again_does_what_is_left(lfref, captures, tmp_path):
    for folder, name in (("a", "first one"), ("b", "third")):
        (tmp_path / folder).mkdir()
        (captures / name).rename(tmp_path / folder / name)
    words = ("refocus", "--multirun", f"input={tmp_path}/a,{tmp_path}/b", f"output={tmp_path}/out", *QUICK)
    assert lfref(*words)[0] == 0
    sheets = sorted((tmp_path / "out").glob("*/*/contact_sheet.png"))
    assert len(sheets) == 2
    shutil.rmtree(sheets[0].parent)
    kept = {sheet: sheet.stat().st_mtime_ns for sheet in sheets[1:]}
    status, errors = lfref(*words)
    assert status == 0, errors
    assert sheets[0].is_file()
    assert all(sheet.stat().st_mtime_ns == time_ns for sheet, time_ns in kept.items())
    status, errors = lfref(*words, "correct=none")
    assert status == 1
    assert "must hold the same job of the sweep" in errors
