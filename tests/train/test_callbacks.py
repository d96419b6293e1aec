"""Steps, statistics and checkpoints that numbers which are not finite must not touch, in real fits."""

import copy
import json
import logging

import numpy as np
import OpenImageIO
import pytest
import torch
from lightning.pytorch import Callback, loggers
from lightning.pytorch.plugins import MixedPrecision

from lfref.errors import InputError, LfrefError
from lfref.functional.psnr import psnr
from lfref.losses.composite import CompositeLoss
from lfref.nets.refnet import RefNet
from lfref.train.callbacks import (
    AtomicCheckpointIO,
    BestCheckpoint,
    Initialization,
    RankAgreement,
    StackPictures,
    StepGuard,
    TrainingRecord,
    log_picture,
    side_by_side,
)
from lfref.train.modules import Refocusing
from tests.train.conftest import batches_of

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*does not have many workers.*",
    "ignore:.*number of training batches.*",
    "ignore:.*Checkpoint directory.*",
    "ignore:.*lr_scheduler.step.*",
)


class Poison(Callback):
    """Puts a NaN into the batches, gradients or weights of some steps; remembers what was there before each."""

    def __init__(self, what, steps):
        self.what, self.steps = what, steps
        self.places = []

    def on_train_batch_start(self, trainer, module, batch, batch_index):
        if batch_index not in self.steps or trainer.current_epoch > 0:
            return
        self.places.append(batch["where"][1])
        self.before = copy.deepcopy((module.net.state_dict(), trainer.optimizers[0].state_dict()))
        if self.what in ("views", "labels"):
            batch[self.what][1].view(-1)[7] = torch.nan
        if self.what == "weights":
            module.net.head.bias.data[1] = torch.inf

    def on_after_backward(self, trainer, module):
        if self.what == "gradient" and trainer.fit_loop.epoch_loop.batch_idx in self.steps:
            module.net.head.weight.grad[0, 0] = torch.inf

    def on_train_batch_end(self, trainer, module, outputs, batch, batch_index):
        if batch_index in self.steps and trainer.current_epoch == 0:
            self.after = copy.deepcopy((module.net.state_dict(), trainer.optimizers[0].state_dict()))


def equal(first, second):
    """Whether nested containers hold the same numbers."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(equal(first[key], second[key]) for key in first)
    if isinstance(first, (list, tuple)):
        return len(first) == len(second) and all(map(equal, first, second))
    return torch.equal(first, second) if isinstance(first, torch.Tensor) else first == second


@pytest.fixture
def batch_norm(module):
    """The module with running statistics to corrupt."""
    net = RefNet(n_planes=3, grid=(3, 3), widths=(8, 8), stem_width=8, normalization="batch")
    return Refocusing(net, CompositeLoss(), module.planes, module.optimizer)


@pytest.mark.parametrize("what", ["views", "labels", "gradient"])
def test_a_poisoned_step_is_named_and_leaves_everything_as_it_was(batch_norm, data, trainer, caplog, what):
    poison, guard = Poison(what, steps=[1]), StepGuard()
    fit = trainer(max_epochs=1, callbacks=[Initialization(), poison, guard])
    with caplog.at_level(logging.WARNING, "lfref"):
        fit.fit(batch_norm, datamodule=data)
    # Adam's moments and count of steps, weights, and batch norm's running statistics.
    assert equal(poison.before, poison.after)
    assert poison.before[1]["state"][0]["step"] == 1
    assert guard.skipped == fit.callback_metrics["train/skipped"] == 1
    assert guard.in_a_row == 0
    (line,) = (record.message for record in caplog.records if "skipped" in record.message)
    assert line.startswith("epoch 0, step 1 skipped (1 so far), not finite: ")
    assert poison.places[0] in line
    assert f"{'gradient' if what == 'gradient' else 'loss'} of " in line
    assert all(value.isfinite().all() for value in batch_norm.state_dict().values())
    assert fit.callback_metrics["val/loss"].isfinite()


def test_accumulated_steps_are_skipped_as_a_whole(batch_norm, data, trainer, caplog):
    poison, guard = Poison("views", steps=[0]), StepGuard()
    start = copy.deepcopy(batch_norm.net.state_dict())
    fit = trainer(max_epochs=1, accumulate_grad_batches=2, limit_train_batches=2, callbacks=[poison, guard])
    fit.fit(batch_norm, datamodule=data)
    assert equal(start, batch_norm.net.state_dict())
    assert guard.skipped == 1
    assert poison.places[0] in caplog.text


def test_training_stops_after_too_many_in_a_row_and_writes_no_checkpoint(module, data, trainer, tmp_path):
    last = BestCheckpoint(tmp_path, monitor="val/mpsnr", mode="max")
    fit = trainer(max_epochs=1, enable_checkpointing=True, callbacks=[Poison("labels", range(3)), StepGuard(2), last])
    with pytest.raises(LfrefError):
        fit.fit(module, datamodule=data)
    assert not list(tmp_path.glob("*.ckpt"))


def test_corrupted_weights_stop_the_run_and_are_never_written(module, data, trainer, tmp_path):
    fit = trainer(max_epochs=1, callbacks=[Poison("weights", [1]), StepGuard()])
    with pytest.raises(LfrefError, match=r"net\.head\.bias"):
        fit.fit(module, datamodule=data)
    with pytest.raises(LfrefError, match=r"net\.head\.bias"):
        fit.save_checkpoint(tmp_path / "bad.ckpt")
    assert not (tmp_path / "bad.ckpt").exists()


def test_a_value_that_is_not_finite_is_never_the_best(module, data, trainer, tmp_path):
    class PoisonedValidation(Callback):
        def on_validation_batch_start(self, trainer, module, batch, batch_index):
            if trainer.current_epoch != 1:
                batch["labels"][0, 0, 0, 0, 0] = torch.nan

    best = BestCheckpoint(tmp_path, filename="best", monitor="val/mpsnr", mode="max")
    fit = trainer(max_epochs=3, enable_checkpointing=True, callbacks=[PoisonedValidation(), best])
    fit.fit(module, datamodule=data)
    assert torch.load(tmp_path / "best.ckpt", weights_only=True)["epoch"] == 1
    assert best.best_model_score.isfinite()


def test_an_overflow_of_float16_is_left_to_the_scaler_and_a_bad_loss_is_not(module, data, trainer):
    start = copy.deepcopy(module.net.state_dict())
    for init_scale, poison in ((2.0**40, ()), (16.0, [1])):
        guard, scaler = StepGuard(), torch.amp.GradScaler("cpu", init_scale=init_scale)
        plugins = [MixedPrecision("16-mixed", "cpu", scaler)]
        fit = trainer(max_epochs=1, callbacks=[Poison("labels", poison), guard], plugins=plugins)
        fit.fit(module, datamodule=data)
        assert guard.skipped == len(poison)
        if not poison:
            assert scaler.get_scale() == 2.0**37
            assert equal(start, module.net.state_dict())
    assert all(value.isfinite().all() for value in module.state_dict().values())


def test_counts_survive_a_resume(module, data, trainer, tmp_path):
    fit = trainer(max_epochs=1, callbacks=[Poison("labels", [2]), StepGuard()])
    fit.fit(module, datamodule=data)
    fit.save_checkpoint(tmp_path / "run.ckpt")
    guard = StepGuard()
    again = trainer(max_epochs=1, callbacks=[guard])
    again.fit(module, datamodule=data, ckpt_path=tmp_path / "run.ckpt", weights_only=True)
    assert (guard.skipped, guard.in_a_row) == (1, 1)


def still(module):
    """The module without learning."""
    module.optimizer = lambda parameters: torch.optim.SGD(parameters, lr=0.0)
    return module


def started(module, batches, crops=slice(None)):
    """Weights of the module's network, initialised by hand on these crops of the batches."""
    net = copy.deepcopy(module.net)
    views, labels = (torch.cat([batch[name] for batch in batches])[crops] for name in ("views", "labels"))
    net.initialize(views, batches[0]["slopes"], labels)
    return net.state_dict()


@pytest.mark.parametrize(("n_crops", "n_batches"), [(1, 1), (3, 2)])
def test_a_new_run_starts_from_crops_of_its_first_batches(module, data, trainer, n_crops, n_batches):
    data.setup("fit")
    expected = started(module, batches_of(data, data.train_dataloader())[:n_batches])
    trainer(max_steps=1, limit_val_batches=0, callbacks=[Initialization(n_crops)]).fit(still(module), datamodule=data)
    assert equal(module.net.state_dict(), expected)


def test_crops_that_are_not_finite_do_not_count(module, data, trainer):
    data.setup("fit")
    expected = started(module, batches_of(data, data.train_dataloader()), crops=[0, 1, 3, 4, 5])
    labelled = data.on_after_batch_transfer

    def spoiled(batch, index):
        batch = labelled(batch, index)
        if batch["where"][0] == second:
            batch["labels"][0, 0, 0, 0, 0] = torch.nan
        return batch

    second = batches_of(data, data.train_dataloader())[1]["where"][0]
    data.on_after_batch_transfer = spoiled
    callbacks = [Initialization(), StepGuard()]
    trainer(max_steps=1, limit_val_batches=0, callbacks=callbacks).fit(still(module), datamodule=data)
    assert equal(module.net.state_dict(), expected)


def test_pictures_show_the_worst_patch_and_the_best(module, data, trainer, tmp_path):
    fit = trainer(max_epochs=2, callbacks=[StackPictures(str(tmp_path / "pictures"), slopes=(-1.5, 0.5))])
    fit.fit(module, datamodule=data)
    files = sorted((tmp_path / "pictures").iterdir())
    assert [file.name for file in files] == ["patches_0000.png", "patches_0001.png"]
    patches = []
    for batch in batches_of(data, data.val_dataloader()):
        with torch.no_grad():
            stacks = module.net(batch["views"])
        patches += [
            (psnr(stack, labels).mean(), labels, stack) for stack, labels in zip(stacks, batch["labels"], strict=True)
        ]
    assert len(patches) == 4
    patches.sort(key=lambda patch: patch[0])
    blocks = [side_by_side(labels[[0, 2]], stack[[0, 2]]) for _, labels, stack in (patches[0], patches[-1])]
    blocks.insert(1, torch.ones(*blocks[0].shape[:2], 4))
    pixels = OpenImageIO.ImageBuf(str(files[-1])).get_pixels("float")
    expected = torch.cat(blocks, -1).permute(1, 2, 0).numpy()
    assert abs(pixels - expected).max() <= 0.5 / 255 + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("n_channels", [1, 3])
def test_pictures_in_wandb_are_the_pictures(tmp_path, n_channels):
    picture = torch.rand(n_channels, 6, 8)
    logger = loggers.WandbLogger(save_dir=tmp_path, offline=True, project="test")
    log_picture(logger, picture, 3)
    logger.experiment.finish()
    (stored,) = tmp_path.glob("wandb/offline-run-*/files/media/images/**/*.png")
    pixels = OpenImageIO.ImageBuf(str(stored)).get_pixels("float")
    np.testing.assert_allclose(pixels[..., :n_channels], picture.permute(1, 2, 0), atol=0.51 / 255)


class Passing(Callback):
    """Lets ten seconds pass in each epoch; raises at the end of one epoch, after its checkpoint."""

    def __init__(self, clock, path, dies_after=None):
        self.clock, self.path, self.dies_after = clock, path, dies_after

    def on_train_epoch_end(self, trainer, module):
        self.clock[0] += 10
        trainer.save_checkpoint(self.path)
        if trainer.current_epoch == self.dies_after:
            self.clock[0] += 1000
            raise SystemExit(143)


def test_a_resumed_training_adds_its_time_to_that_of_its_checkpoint(module, data, trainer, tmp_path, monkeypatch):
    clock, note, last = [100.0], tmp_path / "training.json", tmp_path / "last.ckpt"
    monkeypatch.setattr("lfref.train.callbacks.time.monotonic", lambda: clock[0])
    callbacks = [TrainingRecord(note), Passing(clock, last, dies_after=1)]
    with pytest.raises(SystemExit):
        trainer(max_epochs=3, callbacks=callbacks).fit(module, datamodule=data)
    n_parameters = sum(parameter.numel() for parameter in module.net.parameters())
    expected = {"n_parameters": n_parameters, "device": "cpu", "processes": 1, "best_value": None}
    assert json.loads(note.read_text()) == expected | {"seconds": 20.0, "is_finished": False}
    again = trainer(max_epochs=3, callbacks=[TrainingRecord(note), Passing(clock, last)])
    again.fit(module, datamodule=data, ckpt_path=last, weights_only=True)
    assert json.loads(note.read_text()) == expected | {"seconds": 30.0, "is_finished": True}


def test_ranks_with_another_configuration_are_refused(module, data, trainer):
    fit = trainer(fast_dev_run=True, callbacks=[RankAgreement("mine")])
    fit.strategy.broadcast = lambda value, src=0: "another"
    with pytest.raises(InputError, match="same configuration"):
        fit.fit(module, datamodule=data)


def test_an_interrupted_write_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "c.ckpt"
    AtomicCheckpointIO().save_checkpoint({"step": 1}, path)

    def dies(contents, file):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", dies)
    with pytest.raises(KeyboardInterrupt):
        AtomicCheckpointIO().save_checkpoint({"step": 2}, path)
    assert torch.load(path, weights_only=True)["step"] == 1
    assert list(tmp_path.iterdir()) == [path]
