"""The trainer that the configuration makes: with its guard, without what is set to null, and on which device."""

import pytest
import torch

from lfref.cli import train as command
from lfref.cli.train import _trainer
from lfref.refocuser.load import load
from lfref.train.callbacks import Initialization, StackPictures, StepGuard
from tests.cli.conftest import TINY


def callbacks(trainer, kind):
    return [callback for callback in trainer.callbacks if isinstance(callback, kind)]


def test_training_is_guarded_and_what_is_null_is_left_out(composed):
    (guard,) = callbacks(_trainer(composed("train", "callbacks.guard.patience=3")), StepGuard)
    assert guard.patience == 3
    trainer = _trainer(composed("train", "callbacks.pictures=null", "callbacks.guard=null"))
    assert not callbacks(trainer, (StackPictures, StepGuard))


def test_a_training_that_starts_from_a_file_keeps_its_weights(composed, tmp_path):
    words, files = (*TINY, "trainer.max_epochs=1", "callbacks.pictures=null"), []
    start = f"init_from={tmp_path}/first/checkpoints/last.ckpt"
    for name, more in {"first": (), "second": ("optimizer.lr=0", start)}.items():
        command.train(composed("train", *words, *more, f"folder={tmp_path / name}"), tmp_path / name)
        files.append(tmp_path / name / "checkpoints" / "last.ckpt")
    first, second = (load(file).network.state_dict() for file in files)
    assert all(torch.equal(value, second[name]) for name, value in first.items())
    assert not callbacks(_trainer(composed("train", f"init_from={files[0]}")), Initialization)
    assert callbacks(_trainer(composed("train")), Initialization)


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
