"""A sweep that is said again does what is left to do, and a member that fails ends nothing but itself."""

import csv
import math
import shutil
import subprocess
import sys

import pytest
import torch
from hydra._internal.core_plugins import basic_launcher
from hydra.core.plugins import Plugins

from lfref.io import run as runs
from lfref.io.run import Run
from lfref.train.modules import Refocusing
from tests.cli.conftest import TINY

SWEEP = ("train", "--multirun", *TINY, "trainer.max_epochs=1", "callbacks.progress=null", "callbacks.summary=null")


@pytest.mark.slow
def test_what_is_finished_is_skipped_and_what_was_interrupted_goes_on(lfref, tmp_path, fits, monkeypatch):
    def stop(self):
        if self.trainer.optimizers[0].param_groups[0]["lr"] == 0.02 and self.trainer.current_epoch == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(Refocusing, "on_train_epoch_start", stop)
    words = (*SWEEP, f"output={tmp_path}/sweep", "trainer.max_epochs=2", "optimizer.lr=0.01,0.02,0.03")
    assert lfref(*words)[0] != 0
    assert fits == [(0.01, 0), (0.02, 0)]
    monkeypatch.setattr(Refocusing, "on_train_epoch_start", lambda self: None)
    fits.clear()
    first = torch.load(tmp_path / "sweep" / "0" / "checkpoints" / "last.ckpt", weights_only=True)
    assert lfref(*words)[0] == 0
    assert fits == [(0.02, 1), (0.03, 0)]
    assert all(Run(tmp_path / "sweep" / name).is_finished for name in "012")
    again = torch.load(tmp_path / "sweep" / "0" / "checkpoints" / "last.ckpt", weights_only=True)
    assert all(torch.equal(value, again["state_dict"][name]) for name, value in first["state_dict"].items())
    with (tmp_path / "sweep" / "1" / "log" / "metrics.csv").open() as file:
        assert [row["epoch"] for row in csv.DictReader(file) if row["val/mpsnr"]] == ["0", "1"]


def test_a_member_that_fails_is_named_at_the_end_and_the_rest_runs(lfref, tmp_path, fits):
    status, error = lfref(*SWEEP, f"output={tmp_path}/sweep", "optimizer.lr=-1,0.02")
    assert status == 1
    *_, told, why = error.strip().splitlines()
    assert told == "lfref train: one of the runs failed:"
    assert "sweep/0 (optimizer.lr=-1): " in why
    assert "Invalid learning rate" in why
    assert fits == [(0.02, 0)]
    assert Run(tmp_path / "sweep" / "1").is_finished


@pytest.mark.slow
def test_jobs_return_their_best_validation_also_when_they_are_finished(lfref, tmp_path, monkeypatch, fits):
    Plugins.instance()  # Hydra runs the modules of its plugins again when it first looks for them
    returned, run_job = [], basic_launcher.run_job

    def watch(**arguments):
        job = run_job(**arguments)
        returned.append(job.return_value)
        return job

    monkeypatch.setattr(basic_launcher, "run_job", watch)
    words = (*SWEEP, "trainer.max_epochs=2", f"output={tmp_path}/sweep", "optimizer.lr=0.05,-1,0.02")
    for _ in range(2):
        assert lfref(*words)[0] == 1
    assert fits == [(0.05, 0), (0.02, 0)]
    assert [math.isnan(value) for value in returned] == [False, True, False] * 2
    for name in "02":
        values = [row["val/mpsnr"] for row in Run(tmp_path / "sweep" / name).metrics if row["val/mpsnr"] is not None]
        assert len(values) == 2
        assert returned[int(name)] == returned[3 + int(name)] == pytest.approx(max(values), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plugin", "launcher"),
    [
        ("hydra_plugins.hydra_joblib_launcher", ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")),
        ("hydra_plugins.hydra_submitit_launcher", ("hydra/launcher=submitit_local", "hydra.launcher.timeout_min=5")),
    ],
)
def test_a_failed_job_stops_no_launcher_and_a_rerun_does_what_is_left(tmp_path, plugin, launcher):
    pytest.importorskip(plugin)
    words = (*SWEEP, *launcher, f"output={tmp_path}/sweep", "optimizer.lr=0.01,-1,0.02")
    finished = []
    for _ in range(2):
        ended = subprocess.run(
            [sys.executable, "-m", "lfref.cli.main", *words], cwd=tmp_path, capture_output=True, text=True
        )
        assert ended.returncode == 1, ended.stderr
        *_, told, why = ended.stderr.strip().splitlines()
        assert told == "lfref train: one of the runs failed:"
        assert "sweep/1 (optimizer.lr=-1): " in why
        assert "Invalid learning rate" in why
        checkpoints = [tmp_path / "sweep" / name / "checkpoints" / "last.ckpt" for name in "02"]
        finished.append([checkpoint.stat().st_mtime_ns for checkpoint in checkpoints])
    assert finished[0] == finished[1]
    assert all(Run(tmp_path / "sweep" / name).is_finished for name in "02")


def test_a_note_of_an_earlier_failure_is_none_of_this_sweep(lfref, tmp_path):
    note = tmp_path / "sweep" / "7" / runs.FAILURE
    note.parent.mkdir(parents=True)
    note.write_text('{"overrides": [], "reason": "of last time"}')
    status, error = lfref(*SWEEP, f"output={tmp_path}/sweep", "seed=1,2")
    assert status == 0, error
    assert not note.exists()


def test_a_member_that_raises_what_nobody_foresaw_is_named_too(lfref, tmp_path, monkeypatch):
    def fail(self):
        raise ZeroDivisionError("of this test")

    monkeypatch.setattr(Refocusing, "on_fit_start", fail)
    status, error = lfref(*SWEEP, f"output={tmp_path}/sweep", "seed=1,2")
    assert status == 1
    assert "lfref train: 2 of the runs failed:" in error
    assert "sweep/1 (seed=2): of this test" in error


@pytest.mark.slow
def test_other_members_in_the_folder_of_a_sweep_are_refused_and_kept(lfref, tmp_path, fits):
    words = (*SWEEP, f"output={tmp_path}/sweep")
    assert lfref(*words, "optimizer.lr=0.01,0.02")[0] == 0
    shutil.rmtree(tmp_path / "sweep" / "1")
    status, error = lfref(*words, "optimizer.lr=0.05,0.02")
    assert status == 1
    assert "must have the same jobs in the same order; got another run in" in error
    assert fits == [(0.01, 0), (0.02, 0), (0.02, 0)]
    assert "optimizer.lr=0.01" in Run(tmp_path / "sweep" / "0").overrides


def test_a_launcher_that_fails_is_one_line(lfref, tmp_path, monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    monkeypatch.setenv("PATH", str(tmp_path))  # no SLURM
    status, error = lfref(*SWEEP, f"output={tmp_path}/sweep", "seed=1,2", "hydra/launcher=submitit_slurm")
    assert status == 1
    assert "Traceback" not in error
    last = error.strip().splitlines()[-1]
    assert last.startswith("lfref train: the launcher of a sweep must start each job, and get its result; got Runtime")
