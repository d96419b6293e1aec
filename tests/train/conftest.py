"""A training run small enough for a test: a tiny RefNet on tiny simulated scenes."""

import os
from functools import partial
from pathlib import Path
from unittest import mock

import pytest
import torch
from lightning.pytorch import Trainer

from lfref.data.datamodules import SimulatedData
from lfref.data.labels import OperatorLabels
from lfref.geometry import planes_at_alphas
from lfref.losses.composite import CompositeLoss
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes
from lfref.train.callbacks import AtomicCheckpointIO
from lfref.train.modules import Refocusing

PLANES = planes_at_alphas((0.5, 1.0, 2.0))
SCENES = RandomScenes(Camera((3, 3), (32, 32)))


@pytest.fixture
def module() -> Refocusing:
    net = RefNet(n_planes=3, grid=(3, 3), widths=(8, 8), stem_width=8)
    return Refocusing(net, CompositeLoss(), PLANES, partial(torch.optim.Adam, lr=0.01))


@pytest.fixture
def data() -> SimulatedData:
    labels = OperatorLabels(OperatorRefocuser("shift_and_sum", shift_and_sum), PLANES)
    return SimulatedData(labels, n_fields=3, n_validation=2, scenes=SCENES, patch=24, patches_per_field=2)


def batches_of(data, loader):
    """Batches of a loader as the network gets them."""
    return [data.on_after_batch_transfer(batch, 0) for batch in loader]


@pytest.fixture
def trainer(tmp_path: Path):
    def make(**options) -> Trainer:
        settings = {
            "accelerator": "cpu",
            "logger": False,
            "enable_progress_bar": False,
            "enable_model_summary": False,
            "enable_checkpointing": False,
            "num_sanity_val_steps": 0,
            "use_distributed_sampler": False,
            "default_root_dir": tmp_path,
            "plugins": [AtomicCheckpointIO()],
        }
        return Trainer(**(settings | options))

    # Lightning leaves the port of several processes in the environment, where later trainings would take it over.
    with mock.patch.dict(os.environ):
        yield make
