"""Every experiment, sweep and setup of the pages can be trained, tried by one batch each."""

import importlib
import itertools
import sys

import pandas as pd
import pytest
import torch
import wandb
import yaml

from lfref.bench.evaluation import EvaluationCase
from lfref.cli import config as configs
from lfref.cli import train as command
from lfref.errors import CheckpointError
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.train.modules import Refining, Refocusing
from tests.cli.conftest import TINY, TINY_DATA
from tests.conftest import ROOT

sys.path.append(str(ROOT / "benchmarks"))
ablations, experiments, gpu, paper, training = (
    importlib.import_module(name) for name in ("ablations", "experiments", "gpu", "paper", "training")
)

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


MEMBERS = list(ablations.members(1))
RUNS = ablations.RUNS


def thinned(choices):
    """The first of these choices, and the others for those who have the time."""
    return [pytest.param(choice, marks=pytest.mark.slow if i else ()) for i, choice in enumerate(choices)]


def members():
    """Every combination of every sweep, as overrides."""
    found = []
    for path in sorted(configs.directory("sweeps").glob("*.yaml")):
        parameters = yaml.safe_load(path.read_text())["parameters"]
        choices = [[f"{key}={value}" for value in entry.get("values", ())] for key, entry in parameters.items()]
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
    with pytest.raises(CheckpointError, match=r"learned.safetensors: .* must be"):  # the shipped network is wider
        command.train(composed("train", "experiment=refiner", "start=learned", *small, *data, *FAST), tmp_path)


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


@pytest.mark.parametrize("member", thinned(MEMBERS), ids=lambda member: member.variant)
def test_every_variant_of_the_page_on_ablations_passes_a_fast_dev_run(composed, tmp_path, losses, member):
    small = ("net.widths=[8,8]", "net.stem_width=9")
    command.train(composed("train", *member.overrides, *TINY_DATA, *WHOLE, *small, *FAST), tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


def test_every_training_of_the_ablations_has_a_setup_of_its_own_seed_by_seed():
    members = [*MEMBERS, *(member for member in ablations.members(2) if member.seed == 1)]
    assert members == list(ablations.members(2))
    assert len({member.setup for member in members}) == len({member.folder(RUNS) for member in members}) == len(members)
    other = next(ablations.members(1, ["trainer.max_steps=3"]))
    assert (other.variant, other.seed) == (members[0].variant, members[0].seed)
    assert other.setup != members[0].setup


@pytest.mark.parametrize("size", [gpu.FULL, gpu.TRIAL], ids=["full", "trial"])
def test_every_command_of_the_steps_on_a_gpu_composes(composed, size):
    for step in gpu.steps(size, epochs=2):
        if step.command[: len(gpu.LFREF)] == gpu.LFREF:
            command, *words = step.command[len(gpu.LFREF) :]
            given = [word for word in words if not word.startswith(str(gpu.RUNS))]  # inputs without a name
            assert composed(command, *given).folder


@pytest.mark.slow
def test_a_step_that_was_stopped_does_not_keep_the_others_waiting(tmp_path, monkeypatch, capsys):
    def python(code):
        return sys.executable, "-c", code

    steps = [gpu.Step("slow", python("import time; time.sleep(60)")), gpu.Step("quick", python("print(1)"))]
    monkeypatch.setattr(gpu, "RUNS", tmp_path)
    monkeypatch.setattr(gpu, "steps", lambda size, epochs: iter([*steps, gpu.Step("wrong", python("print(2 / 0)"))]))
    monkeypatch.setattr(gpu, "STEP_S", 5)
    monkeypatch.setattr(sys, "argv", ["gpu.py", "--cpu"])
    for expected in (["slow: stopped", "quick: done", "wrong: failed"], ["slow: stopped", "wrong: failed"]):
        with pytest.raises(SystemExit) as end:
            gpu.main()
        assert end.value.code == 1
        lines = [line for line in capsys.readouterr().out.splitlines() if " after " in line]
        assert [line.startswith(start) for line, start in zip(lines, expected, strict=True)] == [True] * len(expected)
    assert "ZeroDivisionError" in (tmp_path / "wrong.log").read_text()


BASE, RELU = "base", "relu"


def result(member):
    """The row of a training; `relu` is better than the base by 1 dB with seed 0, by 2 dB with seed 1."""
    better = (member.seed + 1) * (member.variant == RELU)
    measures = dict.fromkeys(ablations.MEASURES, 0.5) | {"label_psnr_db": 40.0 + member.seed + better}
    return dict(zip(ablations.KEY, member, strict=False)) | measures | {"n_parameters": 1000, "training_s": 3}


def test_what_is_missing_is_trained_and_each_row_is_kept_as_it_comes(tmp_path):
    path, tried, members = tmp_path / "results.csv", [], list(ablations.members(2))

    def row(member):
        tried.append(member)
        if member.variant == "gelu":
            raise SystemExit("stopped")
        return result(member)

    with pytest.raises(SystemExit, match="stopped"):
        ablations.train(members, path, 1, row)
    assert [member.variant for member in tried[:3]] == [BASE, RELU, "gelu"]
    assert list(ablations.results(path)["variant"]) == [BASE, RELU]
    tried.clear()
    ablations.train(members[:2], path, 1, row)
    assert tried == []
    # Another setup replaces the row of the same variant and seed, and nothing else.
    changed = members[1]._replace(setup="another")
    ablations.train([changed], path, 1, row)
    assert tried == [changed]
    assert len(ablations.of(members, ablations.results(path))) == 1
    assert len(ablations.results(path)) == 2


def test_the_results_of_the_page_are_those_of_its_variants():
    rows = ablations.results(ablations.RESULTS)
    assert set(rows["variant"]) <= set(ablations.VARIANTS)
    assert not rows.duplicated(["variant", "seed"]).any()


@pytest.mark.parametrize("words", [["net.activation=silu"], ["--scenes", "twigs"]])
def test_other_setups_cannot_mix_with_the_results_of_the_page(monkeypatch, capsys, words):
    monkeypatch.setattr(sys, "argv", ["ablations.py", *words])
    with pytest.raises(SystemExit):
        ablations.main()
    assert "need --runs elsewhere" in capsys.readouterr().err


@pytest.mark.parametrize(("n_seeds", "mean", "less"), [(1, "41.0", "+1.0"), (2, "42.0 ± 1.4", "+1.5 (-4.9 to +7.9)")])
def test_the_table_of_ablations_has_paired_intervals_from_two_seeds_on(monkeypatch, n_seeds, mean, less):
    monkeypatch.setattr(ablations, "VARIANTS", {BASE: (), RELU: ()})
    methods = [{"variant": name, "seed": 0, **dict.fromkeys(ablations.MEASURES, 0.25)} for name in ablations.METHODS]
    rows = pd.DataFrame([*methods, *(result(member) for member in ablations.members(n_seeds))])
    lines = ablations.table(rows, dict.fromkeys(rows["variant"], "9 (0.01)"))
    cells = {line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ") for line in lines if line.startswith("|")}
    # Of the differences 1 and 2: mean 1.5, deviation 1 / sqrt 2, t = 12.71 of one degree of freedom.
    assert cells[RELU][1] == mean
    assert cells[RELU][-3:] == [less, "1,000", "9 (0.01)"]
    assert cells[BASE][-3] == ""
    assert cells["mean_of_views"][1] == "0.2"


def test_a_network_is_beside_the_mean_of_the_views_and_its_labels():
    light = LightField(torch.rand(7, 7, 3, 48, 56), "noise")
    case = EvaluationCase(
        "ideal", light, experiments.CLASSICAL["occlusion_aware"](light, experiments.PLANES.slopes), "truth"
    )
    perfect = OperatorRefocuser(f"{experiments.NETWORKS['shift_and_sum']}{experiments.SEED}0", shift_and_sum)
    rows = experiments.plane_rows(
        [case], [*(experiments.CLASSICAL[name] for name in paper.METHODS), perfect], paper.LABELS
    )
    scores = paper.scored(rows)
    own = paper.of(scores, experiments.NETWORKS["shift_and_sum"], "shift_and_sum").iloc[0]
    rival = paper.of(scores, "mean_of_views", "shift_and_sum").iloc[0]
    assert (own["explained"], own["n_db"], own["n_ssim"]) == (pytest.approx(1), 1, 1)
    assert own["psnr_db"] > own["nonzero_psnr_db"] - 1e-9
    assert rival["explained"] == pytest.approx(0)
    assert rival["nonzero_psnr_db"] < rival["psnr_db"]
    assert own["colour_error"] == own["delta_e"] == 0
    at_alpha_1 = rows[
        (rows["alpha"] == 1) & (rows["reference"] == "shift_and_sum") & (rows["method"] == "mean_of_views")
    ]
    assert at_alpha_1["sharpness"].item() == pytest.approx(1, abs=1e-4)


@pytest.mark.slow
def test_what_is_trained_is_kept_and_what_failed_is_told(tmp_path):
    words = [*TINY, "trainer.max_epochs=2"]
    folder = tmp_path / "net"
    training.train(folder, words)
    last = folder / "checkpoints" / "last.ckpt"
    made = last.stat().st_mtime_ns
    training.train(folder, words)
    assert last.stat().st_mtime_ns == made
    with pytest.raises(SystemExit, match="activation must be one of"):
        training.train(tmp_path / "other", [*words, "net.activation=magic"])


def test_the_papers_experiment_makes_its_choices(composed):
    config = composed("train", "experiment=paper", "label=fourier_slice")
    net = config.net
    assert (net.initialization, net.dilation, net.padding, config.end_rate) == ("random", 1, "zeros", 1)
    assert (net.n_blocks, net.activation, net.normalization) == (11, "softplus", "instance")
