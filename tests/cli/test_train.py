"""The trainer that the configuration makes: with its guard, and without what is set to null."""

import pytest

from lfref.cli.train import _trainer
from lfref.train.callbacks import StackPictures
from lfref.train.guard import BestCheckpoint, StepGuard

pytestmark = pytest.mark.filterwarnings("ignore")


def callbacks(trainer, kind):
    return [callback for callback in trainer.callbacks if isinstance(callback, kind)]


def test_training_is_guarded_unless_told_otherwise(composed):
    trainer = _trainer(composed("train", "callbacks.guard.patience=3", "trainer.gradient_clip_val=0.5"))
    (guard,) = callbacks(trainer, StepGuard)
    assert guard.patience == 3
    assert trainer.gradient_clip_val == 0.5
    assert [best.monitor for best in callbacks(trainer, BestCheckpoint)] == ["val/mpsnr"]


def test_a_callback_that_is_null_is_left_out(composed):
    trainer = _trainer(composed("train", "callbacks.pictures=null", "callbacks.guard=null"))
    assert not callbacks(trainer, (StackPictures, StepGuard))
    assert callbacks(trainer, BestCheckpoint)
