"""Run folders, runs that go on, and sweeps."""

import shutil
from typing import ClassVar

import pytest
import torch
from lightning.pytorch.loggers.logger import DummyLogger

from lfref.cli import loggers
from lfref.cli.main import resumed
from lfref.errors import FileError, InputError
from lfref.io.run import Run, write_overrides
from lfref.report.tables import read_table
from lfref.train.modules import Refocusing
from tests.cli.conftest import TINY

SCENE = ("simulate", "scene=sim30", "scene.name=plane", "scene.camera.size=[24,24]", "scene.camera.grid=[3,3]")
QUIET = ("callbacks.progress=null", "callbacks.summary=null", "callbacks.pictures=null", "trainer.log_every_n_steps=1")
TRAIN = ("train", *TINY, *QUIET)


def epochs(run):
    """Epochs whose validation a run has logged."""
    return [row["epoch"] for row in Run(run).metrics if row["val/mpsnr"] is not None]


def last(run):
    return torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)


# Folders.


def test_a_folder_that_has_files_is_refused_and_overwriting_deletes_nothing(lfref, tmp_path):
    out = tmp_path / "out"
    assert lfref(*SCENE, "outputs=[disparity]", f"output={out}")[0] == 0
    (out / "notes.txt").write_text("mine")
    status, error = lfref(*SCENE, "outputs=[views]", f"output={out}")
    assert status == 1
    assert error.startswith("lfref simulate: output must be a new or an empty folder")
    assert lfref(*SCENE, "outputs=[views,disparity]", f"output={out}", "overwrite=true")[0] == 0
    assert {"plane", "plane_disparity.exr", "notes.txt"} <= {path.name for path in out.iterdir()}
    assert (out / "notes.txt").read_text() == "mine"
    assert Run(out).config["outputs"] == ["views", "disparity"]


def test_a_command_that_failed_before_its_results_leaves_a_free_folder(lfref, tmp_path):
    assert lfref(*SCENE, "outputs=[nonsense]", f"output={tmp_path}/out")[0] == 1
    assert lfref(*SCENE, "outputs=[views]", f"output={tmp_path}/out")[0] == 0


# Runs that go on.


def test_resume_becomes_the_overrides_of_the_run_and_those_that_are_given_anew(tmp_path):
    run = tmp_path / "it's a run"
    run.mkdir()
    (run / "config.yaml").write_text("{}")
    write_overrides(run, ["output=old", "net=refnet_small", "+a.b=1", "scheduler=warmup_cosine", "~callbacks.best"])
    folder = str(run).replace("'", "\\'")
    line = resumed([f"resume='{folder}'", "scheduler=constant", "++a.b=2"])
    new = ["scheduler=constant", "++a.b=2"]
    assert line == ["net=refnet_small", "~callbacks.best", f"output='{folder}'", *new, f"resume='{folder}'"]
    assert resumed(["experiment=demo", "resume=null"]) == ["experiment=demo", "resume=null"]
    assert resumed(["resume=auto", "output=none", "seed=1"]) == ["output=none", "seed=1"]
    for words in (["resume=auto", "experiment=demo"], [f"resume={run.parent}"]):
        with pytest.raises((InputError, FileError)):
            resumed(words)


def test_a_run_that_was_moved_goes_on_as_it_was_set_up(lfref, tmp_path):
    words = ("label=fourier_slice", "loss.weights.beta=0.2", "trainer.max_epochs=2")
    assert lfref(*TRAIN, *words, f"output={tmp_path}/run")[0] == 0
    moved = shutil.move(tmp_path / "run", tmp_path / "moved")
    first, best = Run(moved).metrics, Run(moved).training["best_value"]
    status, error = lfref("train", f"resume={moved}", "trainer.max_epochs=3", "optimizer.lr=0.5")
    assert status == 0, error
    assert Run(moved).config["loss"]["weights"]["beta"] == 0.2
    assert Run(moved).metrics[: len(first)] == first
    assert epochs(moved) == [0, 1, 2]
    assert [group["lr"] for group in last(moved)["optimizer_states"][0]["param_groups"]] == [0.5, 0.025]
    assert Run(moved).training["best_value"] >= best
    assert Run(moved).is_finished


# Sweeps.


@pytest.mark.slow
def test_a_sweep_skips_what_is_finished_names_what_failed_and_refuses_other_jobs(lfref, tmp_path, fits, monkeypatch):
    def fail(self):
        if self.trainer.optimizers[0].param_groups[0]["lr"] == 0.02:
            raise InputError("of this test")

    monkeypatch.setattr(Refocusing, "on_train_epoch_start", fail)
    words = (*TRAIN, "--multirun", f"output={tmp_path}/sweep", "optimizer.lr=0.01,0.02", "trainer.max_epochs=1")
    status, error = lfref(*words)
    assert status == 1
    assert "of this test" in error
    assert [rate for rate, _ in fits] == [0.01, 0.02]
    monkeypatch.setattr(Refocusing, "on_train_epoch_start", lambda self: None)
    fits.clear()
    assert lfref(*words)[0] == 0
    assert [rate for rate, _ in fits] == [0.02]
    assert all(Run(tmp_path / "sweep" / name).is_finished for name in "01")
    assert lfref(*words[:-2], "optimizer.lr=0.05,0.06", words[-1])[0] == 1
    assert [rate for rate, _ in fits] == [0.02]
    assert lfref("report", tmp_path / "sweep", f"output={tmp_path}/page")[0] == 0
    variants = read_table(tmp_path / "page" / "sweep.csv")["variant"].tolist()
    assert variants == [f"optimizer.lr={rate}" for rate in (0.01, 0.02)]


class NotedWandbLogger(DummyLogger):
    """In place of wandb's: notes what each run is made with, and is a run of its own unless it gets an id."""

    made: ClassVar[list[dict]] = []

    def __init__(self, **options):
        super().__init__()
        self.made.append(options)
        self.version = options.get("id", f"run_{len(self.made)}")

    version = None


def test_a_job_is_a_run_of_its_sweep_in_wandb_and_a_resumed_one_goes_on_in_it(lfref, tmp_path):
    NotedWandbLogger.made.clear()
    wandb = ("logger=wandb", f"logger.wandb._target_={__name__}.NotedWandbLogger")
    words = (*TRAIN, *wandb, "trainer.max_epochs=1", "net.activation=relu,elu", f"output={tmp_path}/my_sweep")
    status, error = lfref("train", "--multirun", *words[1:])
    assert status == 0, error
    assert [(options["group"], options["job_type"]) for options in NotedWandbLogger.made] == [("my_sweep", "train")] * 2
    assert NotedWandbLogger.made[1]["name"] == "net.activation=elu"
    assert (tmp_path / "my_sweep" / "1" / loggers.ID).read_text() == "run_2\n"
    status, error = lfref("train", f"resume={tmp_path}/my_sweep/1", "trainer.max_epochs=2")
    assert status == 0, error
    assert NotedWandbLogger.made[2]["id"] == "run_2"
