"""Runs in wandb, read back from its offline files."""

import base64
import hashlib
import os
import subprocess

import numpy as np
import OpenImageIO
import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from omegaconf import OmegaConf

import lfref as package
from lfref.cli import loggers, wandb_runs
from tests.cli import wandb_files
from tests.cli.conftest import TINY

WORDS = (*TINY, "callbacks.progress=null", "callbacks.summary=null", "logger=wandb", "logger.wandb.offline=true")


@pytest.fixture
def sweep(lfref, tmp_path):
    """Folder of a sweep of two jobs, one epoch each."""
    added = (
        "+logger.wandb.tags=[mine]",
        "+logger.wandb.entity=team",
        "+logger.wandb.notes=why",
        "trainer.max_epochs=1",
    )
    # The experiment trains by steps on crops that are too small here for the shifts of wide planes.
    added = (*added, "data.patch=64", "data.fields_per_batch=2", "scheduler=cosine", "trainer.max_steps=-1")
    added = (*added, "trainer.precision=32-true")  # Lightning's summary warns of others
    words = (*WORDS, *added, "net.activation=relu,elu", f"output={tmp_path}/my_sweep", "experiment=demo")
    status, errors = lfref("train", "--multirun", *words)
    assert status == 0, errors
    return tmp_path / "my_sweep"


@pytest.mark.slow
def test_a_job_is_a_run_of_its_sweep_and_a_resumed_one_goes_on_in_it(lfref, sweep):
    for number, activation in enumerate(("relu", "elu")):
        (file,) = wandb_files.offline_files(sweep / str(number))
        run = wandb_files.run_of(file)
        assert (run.run_group, run.display_name, run.job_type) == ("my_sweep", f"net.activation={activation}", "train")
        assert (run.project, run.entity, run.notes) == ("lfref", "team", "why")
        assert sorted(run.tags) == ["demo", "mine", "refnet_small", "shift_and_sum"]
        assert run.run_id == (sweep / str(number) / wandb_runs.ID).read_text().strip()
        assert wandb_files.config_of(file)["code"] == loggers.code()
    words = (f"resume={sweep}/0", "trainer.max_epochs=2", "logger=wandb", "logger.wandb.offline=true")
    status, errors = lfref("train", *words)
    assert status == 0, errors
    before, after = wandb_files.offline_files(sweep / "0")
    assert wandb_files.run_of(after).run_id == wandb_files.run_of(before).run_id
    other = wandb_files.run_of(wandb_files.offline_files(sweep / "1")[0])
    assert wandb_files.run_of(before).run_id != other.run_id
    validations = [
        row["epoch"] for file in (before, after) for row in wandb_files.history_of(file) if "val/mpsnr" in row
    ]
    assert validations == [0, 1]
    row = next(row for row in wandb_files.history_of(before) if "val/mpsnr" in row)
    by_plane = [value for name, value in row.items() if name.startswith("val/mpsnr_plane/alpha_")]
    assert len(by_plane) == 16
    assert sum(by_plane) / 16 == pytest.approx(row["val/mpsnr"], abs=1e-4)
    (picture,) = [row for row in wandb_files.history_of(before) if "val/stack/filenames" in row]
    assert picture["val/stack/captions"][0].startswith("worst patch")
    (stored,) = [before.parent / "files" / name for name in picture["val/stack/filenames"]]
    written = sweep / "0" / "pictures" / "patches_0000.png"
    images = [OpenImageIO.ImageBuf(str(path)).get_pixels("uint8") for path in (stored, written)]
    np.testing.assert_array_equal(*images)


def test_a_run_that_goes_on_elsewhere_or_starts_anew_has_an_id_of_its_own(tmp_path):
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    (tmp_path / "run" / "config.yaml").touch()
    (tmp_path / "run" / "checkpoints" / "last.ckpt").touch()
    (tmp_path / "run" / wandb_runs.ID).write_text("abc\n")
    last = f"{tmp_path}/run/checkpoints/last.ckpt"
    for folder, resumed, kept in (("run", last, "abc"), ("other", last, None), ("run", None, None)):
        config = OmegaConf.create({"folder": f"{tmp_path}/{folder}", "resume": resumed})
        assert wandb_runs.options(OmegaConf.create({}), config).get("id") == kept
    own = OmegaConf.create({"version": "mine", "job_type": "test"})
    given = wandb_runs.options(own, OmegaConf.create({"folder": f"{tmp_path}/run", "resume": last}))
    assert not {"id", "job_type"} & given.keys()


@pytest.mark.parametrize(
    ("options", "mode"),
    [({"offline": True}, "offline"), ({}, None), ({"offline": True, "mode": "disabled"}, "disabled")],
)
def test_a_run_is_offline_whatever_ran_before_in_the_process(tmp_path, options, mode):
    assert wandb_runs.WandbLogger(save_dir=tmp_path, **options)._wandb_init.get("mode") == mode


def test_names_have_no_paths():
    words = ["net=refnet", "data.path=/home/me/fields", "output=x", "+hydra.run.dir=x", "logger.wandb.name=x", "seed=1"]
    assert wandb_runs._shown([*words, "data.cache_folder=x", "hydra/launcher=joblib"]) == ["net=refnet", "seed=1"]


def test_the_code_is_the_commit_of_the_working_directory_or_the_version(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert loggers.code() == f"lfref {package.__version__}"
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], [*identity, "commit", "-q", "--allow-empty", "-m", "first"]):
        subprocess.run(["git", *words], check=True)
    head = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    assert loggers.code() == head
    monkeypatch.setenv("PATH", "")
    assert loggers.code() == f"lfref {package.__version__}"


def artifacts_of(folder, kind="model"):
    """Aliases, file name and MD5 digest of each file of the artifacts, without wandb's own `latest`."""
    return [
        ([alias for alias in each.aliases if alias != "latest"], content.path, content.digest)
        for each in wandb_files.artifacts_of(wandb_files.offline_files(folder)[-1])
        if each.type == kind
        for content in each.manifest.contents
    ]


def digest(path):
    return base64.b64encode(hashlib.md5(path.read_bytes()).digest()).decode()


@pytest.mark.slow
def test_checkpoints_are_whole_artifacts_best_and_last(lfref, tmp_path):
    words = [word for word in WORDS if word != "logger.wandb.offline=true"]
    added = ("+logger.wandb.mode=offline", "logger.wandb.log_model=true", "trainer.max_epochs=2")
    status, errors = lfref("train", *words, *added, f"output={tmp_path}/run")
    assert status == 0, errors
    files = {name: tmp_path / "run" / "checkpoints" / f"{name}.ckpt" for name in ("best", "last")}
    expected = [([name], "model.ckpt", digest(path)) for name, path in files.items()]
    assert artifacts_of(tmp_path / "run") == expected


@pytest.mark.slow
def test_a_checkpoint_is_uploaded_again_only_when_it_has_changed(tmp_path):
    logger = wandb_runs.WandbLogger(save_dir=tmp_path, project="test", mode="offline", log_model="all")
    path, digests = tmp_path / "best.ckpt", []
    callback = ModelCheckpoint(dirpath=tmp_path, filename="best")
    callback.best_model_path, callback.best_model_score = str(path), torch.tensor(31.5)
    for epoch in (1, 1, 2):
        if not digests or digests[-1][0] != epoch:
            torch.save({"epoch": epoch}, path)
            os.utime(path, (epoch, epoch))
            digests.append((epoch, digest(path)))
        logger.after_save_checkpoint(callback)
    logger.experiment.finish()
    assert artifacts_of(tmp_path) == [(["best"], "model.ckpt", known) for _, known in digests]
