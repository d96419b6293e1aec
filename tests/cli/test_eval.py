"""`lfref eval` over many light fields: one that fails, and runs that go on."""

import shutil

import pandas as pd
import pytest
import torch

from lfref.functional.psnr import psnr
from lfref.io.read import read, read_stack
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum

QUICK = ("slopes=[-0.3,0.4]", "~references.fourier_slice")


def test_one_that_fails_is_named_and_the_run_goes_on_with_it(lfref, captures, tmp_path):
    words = ("eval", f"input={captures}", "+method@methods.s=shift_and_sum", *QUICK)
    out = tmp_path / "out"
    status, error = lfref(*words, f"output={out}", "resume=auto")
    assert status == 1
    assert "all 3 light fields must be usable; got 1 that failed: second" in error.replace("\n", " ")
    assert set(pd.read_csv(out / "summary.csv")["light_field"]) == {"first one", "third"}

    picture = out / "comparison" / "third.png"
    time_ns = picture.stat().st_mtime_ns
    shutil.rmtree(captures / "second")
    write(captures / "second", LightField(torch.rand(3, 3, 3, 32, 40)))
    status, error = lfref(*words, f"output={out}", "resume=auto")
    assert status == 0, error
    assert picture.stat().st_mtime_ns == time_ns
    assert lfref(*words, f"output={tmp_path}/whole")[0] == 0
    for table in ("planes.csv", "summary.csv"):
        gone_on, whole = (
            pd.read_csv(run / table).sort_values(["light_field", "method"], kind="stable", ignore_index=True)
            for run in (out, tmp_path / "whole")
        )
        pd.testing.assert_frame_equal(gone_on, whole, rtol=1e-12)
    assert {path.stem for path in (out / "comparison").iterdir()} >= {"second", "third"}


def test_the_truth_is_one_more_reference_and_judges_first(lfref, tmp_path):
    words = ("n_fields=2", "scene.camera.size=[64,72]", "slopes=[-0.3,0.4]")
    assert lfref("simulate", f"output={tmp_path}/scenes", *words)[0] == 0
    words = ("eval", f"input={tmp_path}/scenes", "+method@methods.s=shift_and_sum", *QUICK)
    status, error = lfref(*words, f"truth={tmp_path}/scenes", f"output={tmp_path}/out")
    assert status == 0, error
    summary = pd.read_csv(tmp_path / "out" / "summary.csv")
    assert set(summary["reference"]) == {"shift_and_sum", "truth"}
    for row in summary[(summary["reference"] == "truth") & (summary["method"] == "shift_and_sum")].itertuples():
        truth, planes = read_stack(tmp_path / "scenes" / f"{row.light_field}_truth.exr")
        stack = shift_and_sum(read(tmp_path / "scenes" / row.light_field).views, planes.slopes)
        assert row.mpsnr_db == pytest.approx(float(psnr(stack, truth).mean()), abs=1e-3)
    rival = summary[summary["method"] == "mean_of_views"]
    assert rival["reference"].tolist() == ["shift_and_sum", "truth"] * 2
    assert (rival["explained"] == 0).all()
    judged = summary[(summary["reference"] == "truth") & (summary["method"] != "mean_of_views")]
    assert (judged["explained"] > 0.5).all()
    assert (judged["nonzero_mpsnr_db"] == judged["mpsnr_db"]).all()  # no plane has slope 0
    assert "On 2 light fields, shift_and_sum" in (tmp_path / "out" / "eval.log").read_text()
