"""Every experiment, sweep and setup of the pages can be trained, tried by one batch each."""

import importlib
import itertools
import sys

import pandas as pd
import pytest
import wandb
import yaml

from lfref.cli import config as configs
from lfref.cli import train as command
from lfref.errors import CheckpointError
from lfref.report import tables
from lfref.train.modules import Refining, Refocusing
from tests.cli.conftest import TINY, TINY_DATA
from tests.conftest import ROOT

sys.path.append(str(ROOT / "docs"))
ablations, gpu, paper, training = (importlib.import_module(name) for name in ("ablations", "gpu", "paper", "training"))

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


def test_a_refiner_passes_a_fast_dev_run(lfref, composed, tmp_path, monkeypatch):
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


@pytest.mark.parametrize("variant", thinned(ablations.VARIANTS))
def test_every_variant_of_the_page_on_ablations_passes_a_fast_dev_run(composed, tmp_path, losses, variant):
    member = ablations.Member(variant, "long", 0, 0.002)
    config = composed("train", *member.overrides, *TINY_DATA, "net.stem_width=16", *FAST)
    assert config.optimizer.lr == 0.002
    command.train(config, tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


def test_every_network_of_the_pages_has_a_folder_of_its_own_and_one_setup():
    assert len(paper.Experiment().overrides_by_run()) == 4 * 3
    members = [*ablations.tuning(), *(ablations.Member(variant, length, seed, 0.002) for variant in ablations.VARIANTS
               for length in ablations.LENGTHS for seed in range(ablations.N_SEEDS))]  # fmt: skip
    assert len({member.folder(ablations.RUNS) for member in members}) == len(members)
    assert len({" ".join(member.overrides) for member in members}) == len(members)


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


@pytest.fixture
def results(tmp_path):
    """Results of two variants; `relu` is better by 1 and 2 dB, at another rate."""
    found = ablations.Results(tmp_path / "results.csv")
    for variant, best in ((ablations.PAPER, 0.002), ("relu", 0.0006)):
        for rate in ablations.RATES:
            found.add(
                ablations.Member(variant, "short", ablations.TUNING_SEED, rate), {"val_mpsnr_db": -abs(rate - best)}
            )
        for seed in (0, 1):
            value = 20 + seed + (seed + 1) * (variant == "relu")
            measured = dict.fromkeys(("psnr_db", "wide_db", "focus_db", "delta_e"), value)
            found.add(ablations.Member(variant, "short", seed, best), {"val_mpsnr_db": 1, **measured})
    return found


def test_each_variant_has_the_rate_that_its_validation_chose(results):
    assert results.best_rate("relu") == 0.0006
    assert results.best_rate("gelu") is None
    # A training at another rate does not count.
    results.add(ablations.Member("relu", "short", 0, 0.006), {"val_mpsnr_db": 9, "psnr_db": 90})
    assert sorted(results.of("short")["psnr_db"]) == [20, 21, 21, 23]


def test_results_are_kept_and_not_trained_again(results):
    again, member = ablations.Results(results.path), ablations.Member("relu", "short", 1, 0.0006)
    assert again.has(member)
    assert not again.has(ablations.Member("relu", "long", 1, 0.0006))
    n_rows = len(again.rows)
    again.rows.loc[again.rows["variant"] == "relu", "setup"] = "of another version"
    assert not again.has(member)
    again.add(member, {"val_mpsnr_db": 2})
    assert len(again.rows) == n_rows
    assert ablations.Results(results.path).has(member)


def test_results_by_another_truth_do_not_count(results, monkeypatch):
    monkeypatch.setattr(ablations, "EXPERIMENT", "180 fields of 128 px, sim30 of another version")
    again = ablations.Results(results.path)
    assert not again.has(ablations.Member("relu", "short", 1, 0.0006))
    assert again.best_rate("relu") is None


def test_the_results_of_the_page_are_of_one_experiment_and_its_variants():
    rows = tables.read_table(ablations.RESULTS).astype({"seed": int})
    assert rows["experiment"].nunique() == 1
    for row in rows.to_dict("records"):
        member = ablations.Member(*(row[name] for name in ablations.KEY))
        assert row["setup"] == " ".join(member.overrides)


@pytest.mark.parametrize("words", [["net.activation=silu"], ["--scenes", "twigs"]])
def test_other_setups_cannot_mix_with_the_results_of_the_page(monkeypatch, capsys, words):
    monkeypatch.setattr(sys, "argv", ["ablations.py", *words])
    with pytest.raises(SystemExit):
        ablations.main()
    assert "need --runs elsewhere" in capsys.readouterr().err


def test_the_table_of_ablations_has_paired_intervals(results, monkeypatch):
    monkeypatch.setattr(ablations, "VARIANTS", {ablations.PAPER: (), "relu": ()})
    sizes = pd.DataFrame({"variant": [ablations.PAPER, "relu"], "n_parameters": [1000, 2000], "units": [0.5, 0.25]})
    rows = list(ablations.table(results, sizes))
    cells = [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows[2:4]]
    not_trained = [tables.DASH] * 3
    assert cells[0] == [ablations.PAPER, "1,000", "0.50", "0.002", "20.5 ± 0.7", "", tables.DASH, "", *not_trained]
    # Of the differences 1 and 2: mean 1.5, deviation 1 / sqrt 2, t = 12.71 of one degree of freedom.
    relu = ["relu", "2,000", "0.25", "0.0006", "22.0 ± 1.4", "+1.5 (-4.9 to +7.9)", tables.DASH, tables.DASH]
    assert cells[1] == [*relu, *not_trained]


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
