"""Every experiment, sweep and setup of the pages can be trained, tried by one batch each."""

import importlib
import itertools
import sys

import pytest
import wandb
import yaml

from lfref.cli import config as configs
from lfref.cli import train as command
from lfref.errors import CheckpointError
from lfref.train.modules import Refining, Refocusing
from tests.cli.conftest import TINY, TINY_DATA
from tests.conftest import ROOT

sys.path.append(str(ROOT / "docs"))
ablations, paper, training = (importlib.import_module(name) for name in ("ablations", "paper", "training"))

FAST = (
    "trainer.fast_dev_run=1",
    "callbacks=default",
    "~callbacks.progress",
    "~callbacks.summary",
    "~callbacks.best",
    "~callbacks.last",
)
EXPERIMENTS = sorted(
    path.stem for path in (configs.directory() / "experiment").glob("*.yaml") if path.stem not in ("refiner", "mixer")
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


@pytest.mark.parametrize("kind", ["refiner", "mixer"])
def test_networks_that_correct_planes_pass_a_fast_dev_run(lfref, composed, tmp_path, monkeypatch, kind):
    recipe = f"recipe={'default' if kind == 'refiner' else kind}"
    base = ("method@recipe.base=shift_and_sum",) if kind == "refiner" else ()
    small = (recipe, *base, "recipe.scenes.camera.size=[40,40]", "recipe.grids=[[3,3]]")
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
    command.train(composed("train", f"experiment={kind}", *small, *data, *FAST, "~callbacks.average"), tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]
    with pytest.raises(CheckpointError, match=r"learned.safetensors: .* must be"):  # the shipped network is wider
        command.train(composed("train", f"experiment={kind}", "start=learned", *small, *data, *FAST), tmp_path)


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


@pytest.mark.parametrize("variant", thinned(ablations.VARIANTS))
def test_every_variant_of_the_page_on_ablations_passes_a_fast_dev_run(composed, tmp_path, losses, variant):
    words = (*ablations.SETUP, *TINY_DATA, "net.stem_width=16", *ablations.VARIANTS[variant])
    config = composed("train", *words, *FAST)
    command.train(config, tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


def test_every_network_of_the_pages_has_a_folder_of_its_own_and_one_setup():
    experiment = paper.Experiment()
    folders = list(experiment.overrides_by_run()) + list(ablations.overrides_by_run(ablations.RUNS))
    own = {folder for folder in folders if folders.count(folder) == 1}
    shared = set(folders) - own
    assert len(own) == 3 * 3 + 3 * (len(ablations.VARIANTS) - 1)
    assert shared == set(experiment.folders["RefNet on truth"])
    for folder in shared:
        assert experiment.overrides_by_run()[folder] == ablations.overrides_by_run(ablations.RUNS)[folder]


@pytest.mark.slow
def test_what_is_trained_is_kept_and_what_was_stopped_goes_on(tmp_path):
    words = [*TINY, "trainer.max_epochs=2"]
    folder = tmp_path / "net"
    assert training.train({folder: [*words, "seed=1"]}) == {}
    last = folder / "checkpoints" / "last.ckpt"
    made = last.stat().st_mtime_ns
    training.train({folder: [*words, "seed=1"]})
    assert last.stat().st_mtime_ns == made
    with pytest.raises(SystemExit, match="seed=1 seed=2"):
        training.train({folder: [*words, "seed=2"]})
    assert last.stat().st_mtime_ns == made
    other = tmp_path / "other"
    failed = training.train({other: [*words, "net.activation=magic"], folder: [*words, "seed=1"]})
    assert list(failed) == [other]
    assert "activation must be one of" in failed[other]
