"""Two processes on the CPU, started as a user would: by the console script."""

import subprocess
import sys

import pytest
import torch
from lightning.pytorch import Callback

from lfref.train.guard import StepGuard
from tests.cli.conftest import TINY

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
DDP = (*TINY, "trainer=ddp", "trainer.accelerator=cpu", "trainer.devices=2", "trainer.max_epochs=1", "data.n_fields=3")


def train(*words) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from lfref.cli.main import main; main()", "train", *DDP, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240)


def test_two_processes_train_one_network(tmp_path):
    run = train(f"output={tmp_path}/run")
    assert run.returncode == 0, run.stderr
    state = torch.load(tmp_path / "run" / "checkpoints" / "last.ckpt", weights_only=True)
    # Three fields for two processes of one field a step: two steps each.
    assert state["global_step"] == 2
    assert (tmp_path / "run" / "train_ddp_process_1.log").is_file()


def test_processes_with_different_configurations_refuse_to_train(tmp_path):
    run = train(f"output={tmp_path}/run", "loss.weights.gamma=${oc.env:LOCAL_RANK,0}")
    assert run.returncode != 0
    assert "must have the same configuration" in run.stderr
    assert not (tmp_path / "run" / "checkpoints").exists()


class PoisonOfOneProcess(Callback):
    """Puts an infinity into one gradient of the second process, once the processes have exchanged theirs."""

    def on_after_backward(self, trainer, module):
        if trainer.global_rank == 1 and trainer.global_step == 0:
            module.net.head.weight.grad[0, 0] = torch.inf


def test_all_processes_skip_the_step_that_one_cannot_take(module, data, trainer):
    callbacks = [PoisonOfOneProcess(), StepGuard()]
    fit = trainer(max_epochs=1, devices=2, strategy="ddp_spawn", plugins=[], callbacks=callbacks)
    fit.fit(module, datamodule=data)
    # As the first process counts it, whose own gradient was finite.
    assert fit.callback_metrics["train/skipped"] == 1
    assert all(value.isfinite().all() for value in module.state_dict().values())
