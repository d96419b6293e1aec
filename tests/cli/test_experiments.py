"""Every experiment, sweep and setup of the pages can be trained, tried by one batch each."""

import importlib
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

sys.path.append(str(ROOT / "benchmarks"))
ablations, gpu = (importlib.import_module(name) for name in ("ablations", "gpu"))

FAST = (
    "trainer.fast_dev_run=1",
    "callbacks=default",
    "~callbacks.progress",
    "~callbacks.summary",
    "~callbacks.best",
    "~callbacks.last",
)
WHOLE = ("data.patch=64", "data.cache_folder=null", "trainer.precision=32-true")
"""Crops that the views of alpha .125 do not leave, no scenes kept, and a precision that Lightning's summary knows."""
EXPERIMENTS = sorted(
    path.stem for path in (configs.directory() / "experiment").glob("*.yaml") if path.stem != "refiner"
)


def thinned(choices):
    """The first of these choices, and the others for those who have the time."""
    return [pytest.param(choice, marks=pytest.mark.slow if i else ()) for i, choice in enumerate(choices)]


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
    config = composed("train", f"experiment={experiment}", *TINY_DATA, *WHOLE, *FAST)
    command.train(config, tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]
    assert wandb.run is None


def test_a_refiner_passes_a_fast_dev_run(composed, tmp_path, monkeypatch):
    small = (
        "method@data.recipe.base=shift_and_sum",
        "data.recipe.scenes.camera.size=[40,40]",
        "data.recipe.grids=[[3,3]]",
    )
    data = (
        f"data.cache_folder={tmp_path}/cache",
        "data.n_fields=2",
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
    with pytest.raises(CheckpointError, match=r"refiner.safetensors: .* must be"):  # the shipped network is wider
        command.train(composed("train", "experiment=refiner", "init_from=refiner", *small, *data, *FAST), tmp_path)


LABELS = [[f"label={path.stem}"] for path in sorted((configs.directory() / "label").glob("*.yaml"))]
SWEEPS = [
    [f"{name}={entry['values'][-1]}" for name, entry in parameters.items()]
    for path in sorted(configs.directory("sweeps").glob("*.yaml"))
    if path.stem != "bayes"  # which only wandb draws
    for parameters in [yaml.safe_load(path.read_text())["parameters"]]
]


@pytest.mark.parametrize("words", thinned([*LABELS, *SWEEPS]), ids=" ".join)
def test_every_label_source_and_sweep_passes_a_fast_dev_run(composed, tmp_path, losses, words):
    command.train(composed("train", *TINY, *FAST, *words), tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


@pytest.mark.parametrize("member", thinned(list(ablations.members(1))), ids=lambda member: member.variant)
def test_every_variant_of_the_page_on_ablations_passes_a_fast_dev_run(composed, tmp_path, losses, member):
    small = ("net.widths=[8,8]", "net.stem_width=9")
    command.train(composed("train", *member.overrides, *TINY_DATA, *WHOLE, *small, *FAST), tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


def test_every_command_of_the_steps_on_a_gpu_composes(composed):
    for _, words in gpu.steps(epochs=2):
        if words[: len(gpu.LFREF)] == gpu.LFREF:
            name, *overrides = words[len(gpu.LFREF) :]
            assert composed(name, *overrides).folder


def test_the_results_of_the_page_are_those_of_its_variants():
    rows = ablations.results(ablations.RESULTS)
    assert set(rows["variant"]) <= set(ablations.VARIANTS)
    assert not rows.duplicated(["variant", "seed"]).any()


def test_the_papers_experiment_makes_its_choices(composed):
    config = composed("train", "experiment=paper", "label=fourier_slice")
    net = config.net
    assert (net.initialization, net.dilation, net.padding, config.end_rate) == ("random", 1, "zeros", 1)
    assert (net.n_blocks, net.activation, net.normalization) == (11, "softplus", "instance")
