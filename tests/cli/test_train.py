"""The trainer that the configuration makes: with its guard, without what is set to null, and on which device."""

import json
import subprocess
import sys

import pytest
import torch
from hydra.core.hydra_config import HydraConfig
from lightning.pytorch import Callback

from lfref.cli import train as command
from lfref.cli.train import _trainer
from lfref.train.callbacks import BestCheckpoint, StackPictures, StepGuard
from lfref.train.modules import Refocusing
from tests.cli.conftest import TINY


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """Hydra remembers the last command of this process, which may have been a sweep."""
    monkeypatch.setattr(HydraConfig.instance(), "cfg", None)


def callbacks(trainer, kind):
    return [callback for callback in trainer.callbacks if isinstance(callback, kind)]


def test_training_is_guarded_unless_told_otherwise(composed):
    trainer = _trainer(composed("train", "callbacks.guard.patience=3", "trainer.gradient_clip_val=0.5"), Callback())
    (guard,) = callbacks(trainer, StepGuard)
    assert guard.patience == 3
    assert trainer.gradient_clip_val == 0.5
    assert [best.monitor for best in callbacks(trainer, BestCheckpoint)] == ["val/mpsnr"]


def test_a_callback_that_is_null_is_left_out(composed):
    trainer = _trainer(composed("train", "callbacks.pictures=null", "callbacks.guard=null"), Callback())
    assert not callbacks(trainer, (StackPictures, StepGuard))
    assert callbacks(trainer, BestCheckpoint)


@pytest.mark.parametrize(
    ("epoch", "told"),
    [(0, "no epoch was finished; the same command starts anew"), (1, "go on by lfref train resume={}")],
)
def test_a_fit_that_is_stopped_names_the_last_checkpoint(composed, tmp_path, monkeypatch, epoch, told):
    def stop(self):
        if self.trainer.current_epoch == epoch:
            raise SystemExit(143)

    monkeypatch.setattr(Refocusing, "on_train_epoch_start", stop)
    last = tmp_path / "checkpoints" / "last.ckpt"
    with pytest.raises(SystemExit) as stopped:
        command.train(composed("train", *TINY, "trainer.max_epochs=2"), tmp_path)
    assert stopped.value.code == 143
    (note,) = stopped.value.__notes__
    assert note == "; ".join([f"the last checkpoint is {last}"] * last.exists() + [told.format(tmp_path)])
    assert last.exists() == (epoch == 1)


GPU = {"accelerator": "gpu", "devices": 1}


@pytest.mark.parametrize(
    ("trainer", "n_gpus", "expected"),
    [
        (GPU, 2, [[0], [1], [0]]),
        (GPU, 1, [[0], [0], [0]]),
        (GPU, 0, [1, 1, 1]),  # Lightning says that there is none
        ({"accelerator": "auto", "devices": 1}, 3, [[0], [1], [2]]),
        ({"accelerator": "auto", "devices": 1}, 0, [1, 1, 1]),
        ({"accelerator": "cpu", "devices": 1}, 2, [1, 1, 1]),
        ({"accelerator": "gpu", "devices": -1}, 2, [-1, -1, -1]),
        ({"accelerator": "gpu", "devices": [1]}, 2, [[1], [1], [1]]),
        ({"accelerator": "gpu"}, 2, ["auto", "auto", "auto"]),
    ],
)
def test_jobs_side_by_side_take_the_gpus_in_turn(monkeypatch, trainer, n_gpus, expected):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: n_gpus)
    assert [command.devices_of_job(trainer, number) for number in range(3)] == expected


def test_a_training_of_its_own_keeps_its_devices(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert command._devices(GPU) == 1


# The trainer of a user, which notes its devices and trains on the processor, on a machine that seems to have two GPUs.
NOTING = """
import json, torch
from lightning.pytorch import Trainer
torch.cuda.device_count = lambda: 2
class NotingTrainer(Trainer):
    def __init__(self, devices, accelerator, default_root_dir, **options):
        with open(f"{default_root_dir}/devices.json", "w") as file:
            json.dump(devices, file)
        super().__init__(devices=1, accelerator="cpu", default_root_dir=default_root_dir, **options)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("launcher", "words", "expected"),
    [
        (("hydra/launcher=joblib", "hydra.launcher.n_jobs=2"), (), [[0], [1], [0]]),
        (("hydra/launcher=joblib", "hydra.launcher.n_jobs=2"), ("trainer.devices=1",), [1, 1, 1]),
        ((), (), [1, 1, 1]),
    ],
)
def test_each_job_of_a_parallel_sweep_gets_one_gpu(tmp_path, monkeypatch, launcher, words, expected):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    (tmp_path / "noting.py").write_text(NOTING)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    trainer = ("trainer=gpu", "trainer._target_=noting.NotingTrainer")
    line = ("train", "--allow", "noting", "--multirun", *TINY, *trainer, "trainer.max_epochs=1", "seed=1,2,3")
    ended = subprocess.run(
        [sys.executable, "-m", "lfref.cli.main", *line, *launcher, *words, "output=sweep"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    assert [json.loads((tmp_path / "sweep" / name / "devices.json").read_text()) for name in "012"] == expected
