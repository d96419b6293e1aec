"""Refiners learn what is missing, and leave a checkpoint that refocuses."""

import functools

import pytest
import torch
from lightning.pytorch.callbacks import EMAWeightAveraging

import lfref
from lfref.data import planes as plane_sets
from lfref.data.planes import Item, PlaneData, Recipe
from lfref.losses.composite import RelativeError
from lfref.nets.refiner import Refiner
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.train.callbacks import BestCheckpoint, StepGuard
from lfref.train.modules import Refining, WarmupCosine
from tests.data.test_planes import SCENES
from tests.train.test_resume import quiet

BASE = OperatorRefocuser("shift_and_sum", shift_and_sum)
RECIPE = Recipe(SCENES, BASE, features=("central", "spread"))


@pytest.fixture
def data(tmp_path):
    """Planes whose truth is twice as bright where the last feature says so."""
    made = PlaneData(RECIPE, str(tmp_path), n_fields=6, n_validation=2, crop=16, planes_per_batch=4, workers=0)
    torch.manual_seed(0)
    for index in range(6):
        pictures = 0.2 + 0.2 * torch.rand(2, 3, 24, 24)
        mark = (torch.rand(2, 1, 6, 6) > 0.5).float().repeat_interleave(4, 2).repeat_interleave(4, 3)
        slopes = torch.zeros(2, dtype=torch.float64)
        error_scale = torch.full_like(mark, 0.05)
        colours = mark.expand(-1, 3, -1, -1)
        item = Item(torch.cat([2 * colours, mark], 1), pictures, error_scale, 0.1 * colours, slopes)
        plane_sets.write(made.folder / f"{index:06d}.safetensors", item)
    return made


@pytest.fixture
def module():
    torch.manual_seed(0)
    return Refining(
        Refiner(4, 1, width=8, n_blocks=1),
        RelativeError(),
        RECIPE,
        functools.partial(torch.optim.Adam, lr=0.01),
        functools.partial(WarmupCosine, total_steps=60),
    )


@quiet
def test_it_learns_what_is_missing(module, data, trainer):
    fit = trainer(max_steps=60, max_epochs=-1, callbacks=[StepGuard()])
    fit.fit(module, datamodule=data)
    (found,) = fit.validate(module, datamodule=data, verbose=False)
    assert found["val/gain"] > 6
    assert fit.optimizers[0].param_groups[0]["lr"] < 1e-4  # stepped each step: the schedule is over


@quiet
def test_a_checkpoint_of_averaged_weights_refocuses_and_goes_on(module, data, trainer, tmp_path):
    best = BestCheckpoint(tmp_path, "best", monitor="val/gain", mode="max", enable_version_counter=False)
    options = {"max_epochs": -1, "enable_checkpointing": True}
    fit = trainer(max_steps=20, callbacks=[best, EMAWeightAveraging(decay=0.9)], **options)
    fit.fit(module, datamodule=data)
    refocuser = lfref.load(tmp_path / "best.ckpt")
    assert refocuser.base.name == "shift_and_sum"
    views = torch.rand(5, 5, 3, 20, 22)
    stack = refocuser(views, [-0.5, 0.3])
    assert stack.shape == (2, 3, 20, 22)
    assert not torch.equal(stack, BASE(views, [-0.5, 0.3]))
    again = trainer(max_steps=30, callbacks=[best, EMAWeightAveraging(decay=0.9)], **options)
    again.fit(module, datamodule=data, ckpt_path=str(tmp_path / "best.ckpt"), weights_only=True)
    assert again.lr_scheduler_configs[0].scheduler.last_epoch == 30
