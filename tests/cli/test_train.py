"""The trainer that the configuration makes: with its guard, without what is set to null, and on which device."""

import json
import os
import subprocess
import sys

import pytest
import torch
from lightning.pytorch import Callback

from lfref.cli import config as configs
from lfref.cli import train as command
from lfref.cli.train import _trainer
from lfref.refocuser.load import load
from lfref.train.callbacks import BestCheckpoint, Initialization, StackPictures, StepGuard
from lfref.train.modules import Refocusing
from tests.cli.conftest import TINY


def callbacks(trainer, kind):
    return [callback for callback in trainer.callbacks if isinstance(callback, kind)]


def test_training_is_guarded_unless_told_otherwise(composed):
    trainer = _trainer(composed("train", "callbacks.guard.patience=3", "trainer.gradient_clip_val=0.5"), Callback())
    (guard,) = callbacks(trainer, StepGuard)
    assert guard.patience == 3
    assert trainer.gradient_clip_val == 0.5
    assert [best.monitor for best in callbacks(trainer, BestCheckpoint)] == ["val/mpsnr"]


def test_a_training_that_starts_from_a_file_keeps_its_weights(composed, tmp_path):
    words, files = (*TINY, "trainer.max_epochs=1", "callbacks.pictures=null"), []
    start = f"start={tmp_path}/first/checkpoints/last.ckpt"
    for name, more in {"first": (), "second": ("optimizer.lr=0", start)}.items():
        command.train(composed("train", *words, *more, f"folder={tmp_path / name}"), tmp_path / name)
        files.append(tmp_path / name / "checkpoints" / "last.ckpt")
    first, second = (load(file).network.state_dict() for file in files)
    assert all(torch.equal(value, second[name]) for name, value in first.items())
    assert not callbacks(_trainer(composed("train", f"start={files[0]}"), Callback()), Initialization)
    assert callbacks(_trainer(composed("train"), Callback()), Initialization)


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


@pytest.mark.slow
def test_a_compiled_network_trains_as_the_plain_one_does_and_its_checkpoint_loads(composed, tmp_path):
    # Adam would take whole steps along gradients that are little but rounding errors.
    words = (*TINY, "trainer.max_epochs=2", "callbacks.pictures=null", "optimizer._target_=torch.optim.SGD")
    networks = []
    for name, options in {"plain": (), "compiled": ("compile=true", "channels_last=true")}.items():
        command.train(composed("train", *words, *options, f"folder={tmp_path / name}"), tmp_path / name)
        networks.append(load(tmp_path / name / "checkpoints" / "last.ckpt").network)
    plain, compiled = (
        torch.cat([weights.flatten() for weights in network.parameters()]).detach() for network in networks
    )
    assert compiled.allclose(plain, atol=2e-5)


def test_compiling_and_the_memory_layout_are_off_by_default(composed):
    networks = []
    for words in ((), ("compile=true", "channels_last=true")):
        config = composed("train", *TINY, *words)
        networks.append(command.build_module(config, configs.build(config.data)).net)
    assert [network._compiled_call_impl is not None for network in networks] == [False, True]
    weights = [next(weights for weights in network.parameters() if weights.ndim == 4) for network in networks]
    assert [each.is_contiguous(memory_format=torch.channels_last) for each in weights] == [False, True]


@pytest.mark.slow
def test_without_a_compiler_compiling_ends_in_one_line(tmp_path):
    places = {"CXX": str(tmp_path / "none"), "TORCHINDUCTOR_CACHE_DIR": str(tmp_path / "cache")}
    words = ["-m", "lfref.cli.main", "train", *TINY, "compile=true", f"output={tmp_path}/run"]
    done = subprocess.run([sys.executable, *words], env=os.environ | places, capture_output=True, text=True)
    assert done.returncode == 1
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("lfref"))
    assert line.startswith("lfref train: compile=true must find a C++ compiler on a CPU; got")
    assert line.endswith("install g++, or leave out compile=true")


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
