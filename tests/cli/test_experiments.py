import itertools

import pytest
import wandb
import yaml

from lfref.cli import config as configs
from lfref.cli import train as command
from lfref.train.modules import Refining, Refocusing
from tests.cli.conftest import TINY, TINY_DATA

FAST = (
    "trainer.fast_dev_run=1",
    "callbacks=default",
    "~callbacks.progress",
    "~callbacks.summary",
    "~callbacks.best",
    "~callbacks.last",
)
EXPERIMENTS = sorted(
    path.stem for path in (configs.directory() / "experiment").glob("*.yaml") if path.stem != "refiner"
)


def thinned(choices):
    """The first of these choices, and the others for those who have the time."""
    return [pytest.param(choice, marks=pytest.mark.slow if i else ()) for i, choice in enumerate(choices)]


def members():
    """Every combination of every sweep, as overrides."""
    found = []
    for path in sorted(configs.directory("sweeps").glob("*.yaml")):
        parameters = yaml.safe_load(path.read_text())["parameters"]
        choices = [[f"{key}={value}" for value in entry["values"]] for key, entry in parameters.items()]
        found += thinned(itertools.product(*choices))
    return found


@pytest.fixture
def losses(monkeypatch):
    """The loss of every training step that is taken."""
    seen, step = [], Refocusing.training_step

    def watched(self, batch, batch_index):
        seen.append(step(self, batch, batch_index))
        return seen[-1]

    monkeypatch.setattr(Refocusing, "training_step", watched)
    return seen


@pytest.mark.parametrize("experiment", thinned(EXPERIMENTS))
def test_every_experiment_passes_a_fast_dev_run(composed, tmp_path, losses, experiment):
    config = composed("train", f"experiment={experiment}", *TINY_DATA, *FAST)
    command.train(config, tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]
    assert wandb.run is None


def test_the_refiner_passes_a_fast_dev_run(lfref, composed, tmp_path, monkeypatch):
    small = ("method@recipe.base=shift_and_sum", "recipe.scenes.camera.size=[40,40]", "recipe.grids=[[3,3]]")
    places = (f"cache_folder={tmp_path}/cache", f"output={tmp_path}/set")
    assert lfref("prepare", *small, *places, "n_fields=2", "workers=0")[0] == 0
    data = (
        f"data.cache_folder={tmp_path}/cache",
        "data.n_validation=1",
        "data.crop=16",
        "net.width=8",
        "trainer.precision=32-true",
    )
    losses, step = [], Refining.training_step

    def watched(self, batch, batch_index):
        losses.append(step(self, batch, batch_index))
        return losses[-1]

    monkeypatch.setattr(Refining, "training_step", watched)
    command.train(composed("train", "experiment=refiner", *small, *data, *FAST, "~callbacks.average"), tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


@pytest.mark.parametrize("label", thinned(sorted(path.stem for path in (configs.directory() / "label").glob("*.yaml"))))
def test_every_label_source_passes_a_fast_dev_run(composed, tmp_path, losses, label):
    config = composed("train", f"label={label}", *TINY, *FAST)
    command.train(config, tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


@pytest.mark.parametrize("member", members(), ids=" ".join)
def test_every_sweep_member_passes_a_fast_dev_run(composed, tmp_path, losses, member):
    config = composed("train", *TINY, *FAST, *member)
    command.train(config, tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]
