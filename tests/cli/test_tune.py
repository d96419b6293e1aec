"""`lfref tune`: trials are runs of `lfref train`; a study finds the better options, goes on, prunes, notes failures."""

import csv
import subprocess
import sys

import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from lfref.cli import composition, tune
from lfref.errors import InputError
from lfref.io import run as runs
from lfref.io.run import Run
from lfref.train.modules import Refocusing
from tests.cli.conftest import TINY

QUIET = ("callbacks.progress=null", "callbacks.summary=null", "callbacks.pictures=null")
# The paper's start, of one crop: it leaves something to learn in two steps, which the linear one does not.
NET = (
    "net.widths=[4]", "net.n_blocks=1", "net.shuffle=1", "net.dilation=1", "net.padding=zeros", "net.stem_width=8",
    "net.stem_kernel=3", "net.stem_by_colour=false",
)  # fmt: skip
START = ("callbacks.initialization.n_crops=1", "net.initialization=random", "task.end_rate=1")
STUDY = ("tune", *TINY, *QUIET, *NET, *START, "trainer.max_epochs=1")


SEED = 43
"""Seed of a sampler that draws the first of three choices twice, and the others later."""


def table(folder):
    with (folder / tune.TABLE).open(newline="") as file:
        return list(csv.DictReader(file))


def states(folder):
    return [row["state"] for row in table(folder)]


@pytest.mark.slow
def test_twenty_trials_find_the_better_learning_rate_and_are_not_repeated(lfref, tmp_path, fits):
    study = tmp_path / "study"
    words = (*STUDY, f"output={study}", "tune.space={optimizer.lr:{low:1e-6,high:0.1,log:true}}", "tune.n_random=5")
    status, error = lfref(*words)
    assert status == 0, error
    assert states(study) == ["finished"] * 20
    assert [float(row["optimizer.lr"]) for row in table(study)] == pytest.approx([rate for rate, _ in fits])
    best = max(table(study), key=lambda row: float(row["val/mpsnr"]))
    assert float(best["optimizer.lr"]) > 0.03  # a training of two steps learns most by the largest rates
    assert sum(rate > 1e-3 for rate, _ in fits[10:]) >= 8  # half of the random draws are above 3e-4
    experiment = yaml.safe_load((study / tune.BEST).read_text())
    assert experiment == {"optimizer": {"lr": float(best["optimizer.lr"])}}
    (logged,) = [row["val/mpsnr"] for row in Run(study / best["trial"]).metrics if row["val/mpsnr"] is not None]
    assert float(best["val/mpsnr"]) == pytest.approx(logged, rel=1e-5)
    fits.clear()
    before = table(study)
    assert lfref(*words)[0] == 0
    assert fits == []
    assert table(study) == before


@pytest.mark.slow
def test_an_interrupted_study_goes_on_within_its_trial(lfref, tmp_path, fits, monkeypatch):
    def stop(self):
        if len(fits) == 2 and self.trainer.current_epoch == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(Refocusing, "on_train_epoch_start", stop)
    space = "tune.space={optimizer.lr:{low:0.01,high:0.02}}"
    options = (*STUDY, space, "tune.n_trials=3", "trainer.max_epochs=2", "tune.pruner=none")
    assert lfref(*options, f"output={tmp_path}/study")[0] != 0
    monkeypatch.setattr(Refocusing, "on_train_epoch_start", lambda self: None)
    status, error = lfref(*options, f"output={tmp_path}/study")
    assert status == 0, error
    assert states(tmp_path / "study") == ["finished"] * 3
    (first, second, again, third) = fits
    assert (first[1], second[1], third[1]) == (0, 0, 0)
    assert again == (second[0], 1)
    assert [row["epochs"] for row in table(tmp_path / "study")] == ["2", "2", "2"]
    whole = [float(row["optimizer.lr"]) for row in table(tmp_path / "study")]
    fits.clear()
    assert lfref(*options, "trainer.max_epochs=1", f"output={tmp_path}/other")[0] == 0
    assert [rate for rate, _ in fits] == pytest.approx(whole)


@pytest.mark.slow
def test_a_hopeless_trial_ends_early_and_an_impossible_one_is_noted(lfref, tmp_path, fits, monkeypatch):
    # The order of random draws is known by the seed: the first two trials are good, and are never pruned.
    study = tmp_path / "study"
    space = "tune.space={optimizer.lr:[0.05,1e-7,-1]}"
    settings = ("tune.sampler=random", f"tune.seed={SEED}", "tune.n_unpruned=2", "tune.n_trials=7")
    words = (*STUDY, "trainer.max_epochs=3", space, *settings, f"output={study}")
    status, error = lfref(*words)
    assert status == 0, error
    expected = {"0.05": ("finished", "3"), "1e-07": ("pruned", "1"), "-1": ("failed", "")}
    rows = table(study)
    assert [row["optimizer.lr"] for row in rows[:2]] == ["0.05", "0.05"]
    assert {row["optimizer.lr"] for row in rows} == {*expected}
    for row in rows:
        assert (row["state"], row["epochs"]) == expected[row["optimizer.lr"]]
        assert ("Invalid learning rate" in row["reason"]) == (row["state"] == "failed")
    pruned = next(Run(study / row["trial"]) for row in rows if row["state"] == "pruned")
    assert runs.epochs_done(pruned.last) == 1
    assert "optimizer.lr=1e-07" in pruned.overrides
    assert not any("tune" in override for override in pruned.overrides)
    assert "tune" not in pruned.config
    fits.clear()
    assert lfref(*words)[0] == 0
    assert fits == []
    status, error = lfref("report", study, pruned.folder, f"output={tmp_path}/report")
    assert status == 0, error


def test_a_launcher_that_dies_ends_the_study_which_goes_on(lfref, tmp_path, fits, monkeypatch):
    def die(self, job_overrides, initial_job_idx):
        raise RuntimeError("a worker was killed")

    words = (*STUDY, "optimizer.lr=0.05,0.1", "tune.n_trials=1", f"output={tmp_path}/study")
    with monkeypatch.context() as patch:
        launcher = Plugins.instance().class_name_to_class[composition.COMPONENTS["launcher"][0]]
        patch.setattr(launcher, "launch", die)
        status, error = lfref(*words)
    assert status == 1
    assert error.splitlines()[-1].startswith("lfref tune: the launcher must bring its jobs to an end; got a worker was")
    assert lfref(*words)[0] == 0
    assert len(fits) == 1
    assert states(tmp_path / "study") == ["finished"]


@pytest.mark.slow
def test_an_experiment_may_hold_the_space(lfref, tmp_path, fits):
    (tmp_path / "choices" / "experiment").mkdir(parents=True)
    text = "# @package _global_\ntune:\n  n_trials: 2\n  space: {optimizer.lr: {low: 0.01, high: 0.02}}\n"
    (tmp_path / "choices" / "experiment" / "mine.yaml").write_text(text)
    status, error = lfref(*STUDY, "--config-dir", tmp_path / "choices", "experiment=mine", f"output={tmp_path}/study")
    assert status == 0, error
    assert [0.01 <= rate <= 0.02 for rate, _ in fits] == [True, True]


def test_a_study_without_a_trial_that_succeeds_fails(lfref, tmp_path):
    words = (*STUDY, "optimizer.lr=-1,-2", "tune.n_trials=2", f"output={tmp_path}/study")
    status, error = lfref(*words)
    assert status == 1
    assert error.splitlines()[-1].startswith("lfref tune: a study must have a trial that succeeds; got none; see ")
    assert states(tmp_path / "study") == ["failed", "failed"]


@pytest.mark.slow
def test_two_trials_run_side_by_side_by_joblib(tmp_path):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    launcher = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "tune.parallel=2", "tune.n_trials=4")
    space = "tune.space={optimizer.lr:[0.05,1e-7],net.activation:[gelu,relu]}"
    words = (*STUDY, "trainer.max_epochs=2", "tune.n_unpruned=1", space, *launcher, "output=study")
    ended = subprocess.run(
        [sys.executable, "-m", "lfref.cli.main", *words], cwd=tmp_path, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    assert "launching 2 jobs" in ended.stdout
    assert set(states(tmp_path / "study")) <= {"finished", "pruned"}
    assert len(states(tmp_path / "study")) == 4
    for row in table(tmp_path / "study"):
        run = Run(tmp_path / "study" / row["trial"])
        assert f"optimizer.lr={row['optimizer.lr']}" in run.overrides
        assert runs.epochs_done(run.last) == int(row["epochs"])
    *_, line = ended.stdout.strip().splitlines()
    assert line.startswith("lfref train data=simulated ")


def test_the_best_options_are_an_experiment_for_training():
    text = tune._experiment({"net": "refnet_small", "net.widths": "[4,6]", "optimizer.lr": 0.25}, ["net"])
    assert text.startswith("# @package _global_\n")
    assert yaml.safe_load(text) == {
        "defaults": [{"override /net": "refnet_small"}],
        "net": {"widths": [4, 6]},
        "optimizer": {"lr": 0.25},
    }


@pytest.mark.slow
def test_training_takes_the_best_options_beside_another_experiment(lfref, tmp_path):
    (tmp_path / "study" / "experiment").mkdir(parents=True)
    text = tune._experiment({"net": "refnet_narrow", "optimizer.lr": 0.25}, ["net"])
    (tmp_path / "study" / tune.BEST).write_text(text)
    chosen = ("--config-dir", tmp_path / "study", "experiment=[paper_small,best]", "trainer.fast_dev_run=1")
    small = (*TINY[:-4], "data.patch=64", "data.cache_folder=null", "trainer.precision=32-true")
    status, error = lfref("train", *chosen, *small, "net.widths=[4]", "net.n_blocks=1", f"output={tmp_path}/run")
    assert status == 0, error
    config = Run(tmp_path / "run").config
    assert config["optimizer"]["lr"] == 0.25
    assert config["data"]["patches_per_field"] == 1


# The space.


def space(node, *sweeps):
    return tune.search_space(node, OverridesParser.create().parse_overrides(list(sweeps)))


def test_ranges_and_choices_become_distributions():
    found = space(
        {
            "optimizer.lr": {"low": 1e-4, "high": 1e-2, "log": True},
            "net.n_blocks": {"low": 3, "high": 11, "step": 2},
            "net": {"activation": ["gelu", "relu"], "kernel": {"low": 1, "high": 5}},
            "net.widths": [[8, 8], [16]],
            "start": [None, "a b", "learned", "1"],
            "loss.weights.beta": {"low": 0, "high": 1, "step": 0.25},
        }
    )
    assert found == {
        "optimizer.lr": FloatDistribution(1e-4, 1e-2, log=True),
        "net.n_blocks": IntDistribution(3, 11, step=2),
        "net.activation": CategoricalDistribution(["gelu", "relu"]),
        "net.kernel": IntDistribution(1, 5),
        "net.widths": CategoricalDistribution(["[8,8]", "[16]"]),
        "start": CategoricalDistribution(["null", "'a b'", "learned", "'1'"]),
        "loss.weights.beta": FloatDistribution(0, 1, step=0.25),
    }


def test_hydras_sweeps_become_distributions_and_take_precedence():
    sweeps = (
        "optimizer.lr=tag(log,interval(1e-4,1e-2))",
        "net.n_blocks=range(3,12,2)",
        "net.activation=gelu,relu",
        "net.widths=choice([8,8],[16])",
        "loss.weights.beta=interval(0,1)",
    )
    assert space({"net.activation": ["elu"], "seed": [1, 2]}, *sweeps) == {
        "net.activation": CategoricalDistribution(["gelu", "relu"]),
        "seed": CategoricalDistribution(["1", "2"]),
        "optimizer.lr": FloatDistribution(1e-4, 1e-2, log=True),
        "net.n_blocks": IntDistribution(3, 11, step=2),
        "net.widths": CategoricalDistribution(["[8,8]", "[16]"]),
        "loss.weights.beta": FloatDistribution(0, 1),
    }


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"low": 1, "high": "x"}, "tune.space.net.kernel must be a list of choices, or a range with numbers"),
        ({"low": 1}, "tune.space.net.kernel must be a list of choices"),
        ({"low": 1, "high": 2, "base": 2}, "tune.space.net.kernel must be a list of choices"),
        ([], "tune.space.net.kernel must be a list of choices"),
        (3, "tune.space.net.kernel must be a list of choices"),
        ({"low": 2, "high": 1}, "the range of net.kernel must be one that can be searched; got 2 to 1"),
        ({"low": 0, "high": 1.5, "log": True}, "the range of net.kernel must be one that can be searched"),
    ],
)
def test_an_entry_that_is_no_range_is_refused(entry, said):
    with pytest.raises(InputError, match=said):
        space({"net.kernel": entry})


def test_trials_with_consecutive_numbers_are_launched_together():
    assert list(tune._consecutive([3, 4, 5, 7, 8], 2)) == [[3, 4], [5], [7, 8]]


# What is refused before the first trial.

RATE = "optimizer.lr=0.1,0.2"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "lfref tune: tune.space must name the options to search; got none"),
        (("tune.space={optimizer.rate:[1,2]}",), "got 'optimizer.rate'"),
        (("tune.space={net:[refnet,refnest]}",), "net must be one of"),
        ((RATE, "tune.n_trials=0"), "tune.n_trials must be a whole number of at least 1; got 0"),
        ((RATE, "tune.parallel=0.5"), "tune.parallel must be a whole number of at least 1; got 0.5"),
        ((RATE, "tune.sampler=magic"), "tune.sampler must be one of tpe, random; got 'magic'"),
        ((RATE, "tune.trials=3"), "got 'tune.trials'"),
        ((RATE, "trainer=ddp"), "each trial must take one device; got trainer.devices=-1"),
        ((RATE, "callbacks.best=null"), "callbacks.best must say what a study searches for; got null"),
        ((RATE, "resume=x"), "a study goes on by its command, not by resume"),
        ((RATE, "hydra/sweeper=basic"), "the sweeper of a study must be left as it is"),
    ],
)
def test_what_cannot_be_a_study_is_refused_before_its_first_trial(lfref, tmp_path, words, said):
    status, error = lfref(*STUDY, *words, f"output={tmp_path}/study")
    assert status in (1, 2)
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "study" / "0").exists()


@pytest.mark.slow
def test_a_study_of_other_options_is_refused(lfref, tmp_path):
    words = (*STUDY, RATE, "tune.n_trials=1", f"output={tmp_path}/study")
    assert lfref(*words)[0] == 0
    status, error = lfref(*words, "seed=3")
    assert status == 1
    assert "a study must go on with the same settings; got options=" in error
    status, error = lfref("train", "--multirun", *words[1:-2], f"output={tmp_path}/study", RATE)
    assert status == 1
    assert "jobs in the folder of a study must be its trials; got job 1" in error
