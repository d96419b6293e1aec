"""Every experiment, label, sweep and variant of the pages can be trained, tried by one batch each."""

import importlib
import sys

import pytest
import wandb
import yaml

from lfref.cli import config as configs
from lfref.cli import train as command
from lfref.train.modules import Refocusing
from tests.cli.conftest import TINY_DATA, TINY_NET
from tests.conftest import ROOT

sys.path.append(str(ROOT / "benchmarks"))
ablations = importlib.import_module("ablations")

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
EXPERIMENTS = [
    [f"experiment={path.stem}", *WHOLE] for path in sorted((configs.directory() / "experiment").glob("*.yaml"))
]


def thinned(choices):
    """The first of these choices, and the others for those who have the time."""
    return [pytest.param(choice, marks=pytest.mark.slow if i else ()) for i, choice in enumerate(choices)]


@pytest.fixture
def losses(monkeypatch):
    """The loss of every training step that is taken."""
    seen, log = [], Refocusing.log_stage

    def watched(self, stage, values, batch_size):
        seen.extend([values["loss"]] if stage == "train" else [])
        log(self, stage, values, batch_size)

    monkeypatch.setattr(Refocusing, "log_stage", watched)
    return seen


SMALL = ("net.widths=[8,8]", "net.stem_width=9")
LABELS = [[*TINY_NET, f"label={path.stem}"] for path in sorted((configs.directory() / "label").glob("*.yaml"))]
SWEEPS = [
    [*TINY_NET, f"{name}={entry['values'][-1]}"]
    for path in sorted(configs.directory("sweeps").glob("*.yaml"))
    if path.stem != "bayes"  # which only wandb draws
    for name, entry in yaml.safe_load(path.read_text())["parameters"].items()
]
VARIANTS = [[*member.overrides, *WHOLE, *SMALL] for member in ablations.members()]
CHOICES = [choice for kind in (EXPERIMENTS + VARIANTS, LABELS, SWEEPS) for choice in thinned(kind)]


@pytest.mark.parametrize("words", CHOICES, ids=" ".join)
def test_every_experiment_label_sweep_and_variant_passes_a_fast_dev_run(composed, tmp_path, losses, words):
    command.train(composed("train", *TINY_DATA, *words, *FAST), tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]
    assert wandb.run is None


def test_the_papers_experiment_makes_its_choices(composed):
    config = composed("train", "experiment=paper", "label=fourier_slice")
    net = config.net
    assert (net.initialization, net.dilation, net.padding, config.end_rate) == ("random", 1, "zeros", 1)
    assert (net.n_blocks, net.activation, net.normalization) == (11, "softplus", "instance")
