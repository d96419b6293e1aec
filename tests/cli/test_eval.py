"""`lfref eval` over many light fields: one that fails, runs that go on, and shards."""

import json
import shutil

import pandas as pd
import torch

from lfref.io.write import write
from lfref.lightfield import LightField
from tests.cli.test_bad_input import assert_one_line

QUICK = ("slopes=[-0.3,0.4]", "~references.fourier_slice")


def repair(captures):
    """Write the capture anew that cannot be read."""
    shutil.rmtree(captures / "second")
    write(captures / "second", LightField(torch.rand(3, 3, 3, 32, 40)))


def test_one_that_fails_is_named_and_the_run_goes_on_with_it(lfref, captures, tmp_path):
    words = ("eval", f"input={captures}", "+method@methods.s=shift_and_sum", *QUICK)
    out = tmp_path / "out"
    status, error = lfref(*words, f"output={out}", "resume=auto")
    assert status == 1
    assert "all 3 light fields must be usable; got 1 that failed: second" in error.replace("\n", " ")
    assert set(pd.read_csv(out / "summary.csv")["light_field"]) == {"first one", "third"}

    picture = out / "comparison" / "third.png"
    time_ns = picture.stat().st_mtime_ns
    repair(captures)
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
    listed = json.loads((out / ".lfref.json").read_text())["files"]
    assert {"planes.csv", "comparison/second.png", "comparison/third.png"} <= listed.keys()
    line = assert_one_line(*lfref(*words, f"resume={out}", "slopes=[0]"))
    assert "settings that it began with" in line


def test_a_sweep_of_shards_that_is_given_again_does_what_is_left(lfref, captures, tmp_path):
    words = ("eval", "--multirun", f"input={captures}", f"output={tmp_path}/out", "shard=1/3,2/3,3/3", *QUICK)
    status, error = lfref(*words)
    assert status == 1
    assert "second" in error
    pictures = sorted((tmp_path / "out").glob("*/comparison/*.png"))
    assert [path.stem for path in pictures] == ["first one", "third"]
    times_ns = [path.stat().st_mtime_ns for path in pictures]
    repair(captures)
    status, error = lfref(*words)
    assert status == 0, error
    assert [path.stat().st_mtime_ns for path in pictures] == times_ns
    assert len(list((tmp_path / "out").glob("*/comparison/*.png"))) == 3


def test_a_share_without_light_fields_is_one_clear_line(lfref, captures, tmp_path):
    line = assert_one_line(*lfref("eval", f"input={captures}", f"output={tmp_path}/out", "shard=4/4", *QUICK))
    assert "a table must have at least one row" in line
