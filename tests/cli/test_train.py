"""The trainer that the configuration makes: with its guard, and without what is set to null."""

import pytest
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
