import copy
import math
from functools import partial

import pytest
import torch
from lightning.pytorch import Callback
from lightning.pytorch.callbacks import ModelCheckpoint

from lfref.train.callbacks import BestCheckpoint, CSVLogger, Initialization
from lfref.train.modules import WarmupCosine

quiet = pytest.mark.filterwarnings(
    "ignore:.*does not have many workers.*", "ignore:.*number of training batches.*", "ignore:.*Checkpoint directory.*"
)


def cosine(module, epochs, rate=0.01):
    module.optimizer = partial(torch.optim.Adam, lr=rate)
    module.scheduler = partial(torch.optim.lr_scheduler.CosineAnnealingLR, T_max=epochs)
    return module


def warmed_up(module, epochs):
    """Slow ends, and a schedule by step, of three steps an epoch."""
    module.optimizer, module.end_rate = partial(torch.optim.Adam, lr=0.01), 0.04
    module.scheduler = partial(WarmupCosine, total_steps=3 * epochs, warmup=0.4)
    return module


class Rates(Callback):
    """The learning rates of all groups of parameters, at the start of each epoch."""

    def __init__(self):
        self.seen = []

    def on_train_epoch_start(self, trainer, module):
        self.seen.append([group["lr"] for group in trainer.optimizers[0].param_groups])


class StoppedInEpochOne(Callback):
    """Writes a checkpoint after the second of three steps of the second epoch, and stops."""

    def __init__(self, path):
        self.path = path

    def on_train_batch_end(self, trainer, module, outputs, batch, batch_index):
        if (trainer.current_epoch, batch_index) == (1, 1):
            trainer.save_checkpoint(self.path)
            raise SystemExit(143)


@quiet
@pytest.mark.parametrize(("schedule", "workers"), [(cosine, 0), (warmed_up, 2)])
def test_a_run_that_is_stopped_within_an_epoch_is_resumed_to_the_bit(
    module, data, trainer, tmp_path, schedule, workers
):
    data.workers = workers
    broken, path = copy.deepcopy(schedule(module, 4)), tmp_path / "last.ckpt"
    trainer(max_epochs=4, callbacks=[Initialization(), unbroken := Rates()]).fit(module, datamodule=data)
    again = copy.deepcopy(broken)
    with pytest.raises(SystemExit):
        trainer(max_epochs=4, callbacks=[Initialization(), StoppedInEpochOne(path)]).fit(broken, datamodule=data)
    fit = trainer(max_epochs=4, callbacks=[Initialization(), resumed := Rates()])
    fit.fit(again, datamodule=data, ckpt_path=path, weights_only=True)
    assert fit.global_step == 12
    assert resumed.seen == unbroken.seen[2:]
    assert len(resumed.seen[0]) == (2 if schedule is warmed_up else 1)
    for name, value in module.state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name


class Killed(Callback):
    """Ends the training after a step, like a signal that cannot be handled."""

    def __init__(self, step):
        self.step = step

    def on_train_batch_end(self, trainer, module, outputs, batch, batch_index):
        if trainer.global_step == self.step:
            raise SystemExit(137)


@pytest.fixture(scope="module")
def unbroken():
    return {}


@quiet
@pytest.mark.parametrize("step", [4, 5])
def test_a_run_that_is_killed_at_any_step_is_resumed_from_its_last_checkpoint_to_the_bit(
    module, data, trainer, tmp_path, unbroken, step
):
    """Checkpoints are due after every step here, within epochs of three steps."""
    torch.manual_seed(0)
    for value in module.parameters():
        torch.nn.init.normal_(value, std=0.1)
    broken, again = copy.deepcopy(cosine(module, 4)), copy.deepcopy(module)
    if not unbroken:
        trainer(max_epochs=4).fit(module, datamodule=data)
        unbroken |= module.state_dict()
    path = tmp_path / "last.ckpt"

    def each():
        return ModelCheckpoint(tmp_path, "last", every_n_train_steps=1, enable_version_counter=False)

    with pytest.raises(SystemExit):
        trainer(max_epochs=4, enable_checkpointing=True, callbacks=[each(), Killed(step)]).fit(broken, datamodule=data)
    assert torch.load(path, weights_only=True)["global_step"] == step - 1
    fit = trainer(max_epochs=4, enable_checkpointing=True, callbacks=[each()])
    fit.fit(again, datamodule=data, ckpt_path=path, weights_only=True)
    for name, value in again.state_dict().items():
        assert torch.equal(value, unbroken[name]), name


@quiet
def test_a_longer_schedule_and_another_rate_are_taken_as_if_from_the_start(module, data, trainer, tmp_path):
    fit = trainer(max_epochs=2, callbacks=[Initialization()])
    fit.fit(cosine(module, 2), datamodule=data)
    fit.save_checkpoint(tmp_path / "last.ckpt")
    fit = trainer(max_epochs=5, callbacks=[rates := Rates()])
    fit.fit(cosine(module, 5, 0.1), datamodule=data, ckpt_path=tmp_path / "last.ckpt", weights_only=True)
    expected = [0.05 * (1 + math.cos(math.pi * epoch / 5)) for epoch in (2, 3, 4)]
    assert [rate for (rate,) in rates.seen] == pytest.approx(expected)
    moments = fit.optimizers[0].state_dict()["state"][0]
    assert moments["step"] == 15  # three steps an epoch: the moments were not started anew


@quiet
def test_the_best_score_is_remembered_where_the_run_has_moved(module, data, trainer, tmp_path):
    def best(folder):
        return BestCheckpoint(tmp_path / folder, "best", monitor="val/mpsnr", mode="max", enable_version_counter=False)

    fit = trainer(max_epochs=1, enable_checkpointing=True, callbacks=[first := best("old")])
    fit.fit(module, datamodule=data)
    (tmp_path / "old").rename(tmp_path / "new")
    state = torch.load(tmp_path / "new" / "best.ckpt", weights_only=True)
    unbeaten = first.best_model_score + 100
    for callback in state["callbacks"].values():
        callback |= {"best_model_score": unbeaten, "kth_value": unbeaten}
        callback["best_k_models"] = dict.fromkeys(callback["best_k_models"], unbeaten)
    torch.save(state, tmp_path / "new" / "best.ckpt")
    fit = trainer(max_epochs=2, enable_checkpointing=True, callbacks=[second := best("new")])
    fit.fit(module, datamodule=data, ckpt_path=tmp_path / "new" / "best.ckpt", weights_only=True)
    assert second.best_model_score == unbeaten
    assert second.best_model_path == str(tmp_path / "new" / "best.ckpt")
    assert torch.load(tmp_path / "new" / "best.ckpt", weights_only=True)["epoch"] == 0


@quiet
def test_a_resumed_log_goes_on_below_what_was_logged(module, data, trainer, tmp_path):
    def fit(epochs, path=None):
        options = {"logger": CSVLogger(tmp_path, name="", version="log"), "log_every_n_steps": 1}
        made = trainer(max_epochs=epochs, **options)
        made.fit(module, datamodule=data, ckpt_path=path, weights_only=True)
        made.save_checkpoint(tmp_path / "last.ckpt")
        return (tmp_path / "log" / "metrics.csv").read_text().splitlines()

    first, second = fit(1), fit(2, tmp_path / "last.ckpt")
    assert second[: len(first)] == first
    assert [line.split(",")[0] for line in second[1:]] == ["0"] * 4 + ["1"] * 4
