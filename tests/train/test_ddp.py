"""Two processes on the CPU, started as a user would: by the console script."""

import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from lightning.pytorch import Callback

from lfref.train.callbacks import Initialization, RankAgreement, StepGuard
from tests.cli.conftest import TINY, lfref  # noqa: F401  a fixture

pytestmark = pytest.mark.slow
SETTINGS = (
    *TINY, "trainer.accelerator=cpu", "trainer.max_epochs=1", "trainer.log_every_n_steps=1", "data.n_fields=4",
    "optimizer._target_=torch.optim.SGD", "callbacks.progress=null", "callbacks.summary=null",
)  # fmt: skip
DDP = ("trainer=ddp", *SETTINGS, "trainer.devices=2")
WARNING = re.compile(r"^.*(?:Warning:|recommended|/site-packages/.*\.py:\d+:).*$", re.M)


def train(*words) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from lfref.cli.main import main; main()", "train", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240)


def logged(run):
    with (run / "log" / "metrics.csv").open() as file:
        return [float(row["train/loss"]) for row in csv.DictReader(file) if row["train/loss"]]


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Folder of what two processes trained, with one light field a step each."""
    folder = tmp_path_factory.mktemp("ddp") / "run"
    run = train(*DDP, f"output={folder}")
    assert run.returncode == 0, run.stderr
    assert WARNING.findall(run.stderr) == []
    return folder


def test_two_processes_train_and_log_as_one_with_the_same_batches(two, tmp_path, lfref):  # noqa: F811
    assert (two / "train_ddp_process_1.log").is_file()
    status, errors = lfref("train", *SETTINGS, "data.fields_per_batch=2", f"output={tmp_path}/run")
    assert status in (0, None), errors
    # Four fields for two processes of one field a step: two steps an epoch.
    assert len(logged(two)) == 2
    assert logged(two) == pytest.approx(logged(tmp_path / "run"), rel=1e-5)
    one, other = (torch.load(path / "checkpoints" / "last.ckpt", weights_only=True) for path in (tmp_path / "run", two))
    for name, value in one["state_dict"].items():
        torch.testing.assert_close(other["state_dict"][name], value, atol=1e-5, rtol=0)


def test_two_processes_resume_together(two, tmp_path):
    shutil.copytree(two, tmp_path / "run")
    run = train(f"resume={tmp_path}/run", "trainer.max_epochs=2")
    assert run.returncode == 0, run.stderr
    assert torch.load(tmp_path / "run" / "checkpoints" / "last.ckpt", weights_only=True)["global_step"] == 4
    assert logged(tmp_path / "run")[:2] == logged(two)
    assert len(logged(tmp_path / "run")) == 4


class PoisonOfOneProcess(Callback):
    """Makes the first loss of the second process infinite, whose gradients stay finite."""

    def on_before_backward(self, trainer, module, loss):
        if trainer.global_rank == 1 and trainer.global_step == 0:
            loss.data.fill_(torch.inf)


class AgreementOfForks(RankAgreement):
    """Takes the rank for the configuration's hash."""

    def setup(self, trainer, pl_module, stage):
        self.fingerprint = str(trainer.global_rank)
        super().setup(trainer, pl_module, stage)


quiet = pytest.mark.filterwarnings(
    "ignore:.*does not have many workers.*", "ignore:.*number of training batches.*", "ignore:.*fork.*"
)


@quiet
def test_processes_with_different_configurations_refuse_to_train(module, data, trainer):
    with pytest.raises(Exception, match="must have the same configuration"):
        trainer(max_epochs=1, callbacks=[AgreementOfForks("")], devices=2, strategy="ddp_fork", plugins=[]).fit(
            module, datamodule=data
        )


@quiet
def test_all_processes_skip_the_step_that_one_cannot_take(module, data, trainer):
    callbacks = [PoisonOfOneProcess(), StepGuard()]
    options = {"devices": 2, "strategy": "ddp_fork", "plugins": [], "limit_train_batches": 2, "limit_val_batches": 0}
    fit = trainer(max_epochs=1, callbacks=callbacks, **options)
    fit.fit(module, datamodule=data)
    # As the first process counts it, whose own gradient was finite.
    assert fit.callback_metrics["train/skipped"] == 1
    assert all(value.isfinite().all() for value in module.state_dict().values())


class Weights(Callback):
    """Writes the weights of each process after the linear start and at the end."""

    def on_train_epoch_start(self, trainer, module):
        self.write(trainer, module, "start")

    def on_train_end(self, trainer, module):
        self.write(trainer, module, "end")

    def write(self, trainer, module, when):
        torch.save(module.net.state_dict(), Path(trainer.default_root_dir) / f"{when}_{trainer.global_rank}.pt")


@quiet
def test_processes_start_and_end_with_equal_weights(module, data, trainer, tmp_path):
    options = {"devices": 2, "strategy": "ddp_fork", "plugins": [], "limit_val_batches": 0}
    before = {name: value.clone() for name, value in module.net.state_dict().items()}
    trainer(max_epochs=1, callbacks=[Initialization(), Weights()], **options).fit(module, datamodule=data)
    for when in ("start", "end"):
        one, other = (torch.load(tmp_path / f"{when}_{rank}.pt", weights_only=True) for rank in range(2))
        assert all(torch.equal(value, other[name]) for name, value in one.items())
        assert not torch.equal(one["trunk.0.weight"], before["trunk.0.weight"])
