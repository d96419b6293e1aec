"""A study draws the same trials whether it was interrupted or not, and its pruner ends trainings that lag behind."""

from types import SimpleNamespace

import pytest
import torch
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState

from lfref.errors import FileError, InputError
from lfref.train import tuning
from lfref.train.tuning import Settings, TrialReports

SETTINGS = Settings("tpe", 4, 0, "median", 2, 0, "val/mpsnr", "max")
SPACE = {
    "optimizer.lr": FloatDistribution(1e-4, 1e-1, log=True),
    "net.n_blocks": IntDistribution(3, 11, step=2),
    "net.activation": CategoricalDistribution(["gelu", "relu"]),
}


def value(parameters):
    """A score that one learning rate and one depth make best."""
    return -abs(parameters["optimizer.lr"] - 0.01) - abs(parameters["net.n_blocks"] - 7)


def drawn(file, n_trials, settings=SETTINGS, interruptions=()):
    """Parameters of trials; a process that ends there has asked for a trial, and drawn none of its parameters."""
    study, found = tuning.begin(file, settings, {}), []
    for number in range(n_trials):
        assert study.ask().number == number
        if number in interruptions:
            study = tuning.begin(file, settings, {})
        found.append(tuning.draw(study, settings, SPACE, number))
        tuning.tell(study, number, value(found[-1]), "")
    return found


@pytest.mark.parametrize("sampler", tuning.SAMPLERS)
def test_an_interrupted_study_draws_the_trials_of_one_that_was_not(tmp_path, sampler):
    settings = SETTINGS._replace(sampler=sampler)
    whole = drawn(tmp_path / "whole", 10, settings)
    assert drawn(tmp_path / "parts", 10, settings, interruptions=(1, 4, 7)) == whole
    assert len({parameters["optimizer.lr"] for parameters in whole}) == 10
    assert drawn(tmp_path / "other", 1, settings._replace(seed=1)) != whole[:1]


def test_drawing_again_changes_no_parameter(tmp_path):
    study = tuning.begin(tmp_path / "study", SETTINGS, {})
    study.ask()
    first = tuning.draw(study, SETTINGS, SPACE, 0)
    assert tuning.draw(tuning.begin(tmp_path / "study", SETTINGS, {}), SETTINGS, SPACE, 0) == first
    assert {"optimizer.lr", "net.n_blocks", "net.activation"} == first.keys()
    assert first["net.n_blocks"] in (3, 5, 7, 9, 11)


def test_tpe_finds_better_values_than_random_draws(tmp_path):
    best = {
        sampler: max(map(value, drawn(tmp_path / sampler, 40, SETTINGS._replace(sampler=sampler))[20:]))
        for sampler in tuning.SAMPLERS
    }
    assert best["tpe"] > -0.003
    assert best["tpe"] > best["random"]


def test_a_trial_without_a_value_failed_and_says_why(tmp_path):
    study = tuning.begin(tmp_path / "study", SETTINGS, {})
    for number, score in enumerate((None, float("nan"), 3.0)):
        study.ask()
        tuning.tell(study, number, score, "disk full")
        tuning.tell(study, number, 7.0, "a finished trial stays as it is")
    states = [(trial.state, trial.value, trial.user_attrs.get(tuning.REASON)) for trial in study.get_trials()]
    failed = (TrialState.FAIL, None, "disk full")
    assert states == [failed, failed, (TrialState.COMPLETE, 3.0, None)]


def test_a_study_with_other_settings_is_refused(tmp_path):
    tuning.begin(tmp_path / "study", SETTINGS, {"options": ["seed=1"]})
    with pytest.raises(
        InputError, match=r"same settings; got seed=3 instead of 0; options=\[\] instead of \['seed=1'\]"
    ):
        tuning.begin(tmp_path / "study", SETTINGS._replace(seed=3), {"options": []})
    for name in ("sampler", "pruner"):
        with pytest.raises(InputError, match=rf"tune\.{name} must be one of"):
            tuning.begin(tmp_path / "other", SETTINGS._replace(**{name: "magic"}), {})


def test_a_file_that_is_no_study_is_refused(tmp_path):
    (tmp_path / "study").write_text("hello\nworld\n")
    with pytest.raises(FileError, match="must be a study"):
        tuning.begin(tmp_path / "study", SETTINGS, {})


# Reports. A trainer is replaced by what the callback reads of it.


def validate(callback, epoch, score, max_epochs=9):
    """One validation; returns whether training ends."""
    trainer = SimpleNamespace(
        callback_metrics={"val/mpsnr": torch.tensor(score)},
        current_epoch=epoch,
        max_epochs=max_epochs,
        sanity_checking=False,
        should_stop=False,
    )
    callback.on_validation_end(trainer, None)
    return trainer.should_stop


def study_of_two(file, settings=SETTINGS):
    """A study whose third trial runs; two have 20 and 22 after one epoch, and gain 2 by each further one."""
    study, gain = tuning.begin(file, settings, {}), 2 if settings.mode == "max" else -2
    for number, score in enumerate((20.0, 22.0)):
        study.ask()
        callback = TrialReports(file, number)
        for epoch in range(3):
            validate(callback, epoch, score + gain * epoch)
        tuning.tell(study, number, score + 2 * gain, "")
    study.ask()
    return study


def test_a_training_below_the_median_of_others_ends_as_pruned(tmp_path):
    study = study_of_two(tmp_path / "study")
    callback = TrialReports(tmp_path / "study", 2)
    assert not validate(callback, 0, 21.5)
    assert validate(callback, 1, 22.5)
    callback.on_train_end(None, None)
    trial = study.get_trials()[2]
    assert trial.state == TrialState.PRUNED
    assert trial.intermediate_values == {1: 21.5, 2: 22.5}
    tuning.tell(study, 2, 22.5, "")
    assert study.get_trials()[2].state == TrialState.PRUNED


@pytest.mark.parametrize(
    ("settings", "max_epochs"),
    [
        (SETTINGS._replace(pruner="none"), 9),
        (SETTINGS._replace(n_unpruned=3), 9),
        (SETTINGS._replace(warmup_epochs=1), 9),
        (SETTINGS, 1),
    ],
)
def test_a_training_goes_on_without_a_pruner_enough_others_or_further_epochs(tmp_path, settings, max_epochs):
    study_of_two(tmp_path / "study", settings)
    callback = TrialReports(tmp_path / "study", 2)
    assert not validate(callback, 0, 1.0, max_epochs)
    callback.on_train_end(None, None)
    assert tuning.opened(tmp_path / "study").get_trials()[2].state == TrialState.RUNNING


def test_pruning_begins_after_the_warm_up(tmp_path):
    study_of_two(tmp_path / "study", SETTINGS._replace(warmup_epochs=1))
    callback = TrialReports(tmp_path / "study", 2)
    assert [validate(callback, epoch, 1.0) for epoch in range(2)] == [False, True]


def test_the_smallest_value_counts_where_the_mode_says_so(tmp_path):
    study = study_of_two(tmp_path / "study", SETTINGS._replace(mode="min"))
    assert study.best_trial.value == 16.0
    assert not validate(TrialReports(tmp_path / "study", 2), 0, 20.5)
    assert validate(TrialReports(tmp_path / "study", 2), 1, 19.5)


def test_successive_halving_keeps_the_best_quarter(tmp_path):
    file = tmp_path / "study"
    study = tuning.begin(file, SETTINGS._replace(pruner="halving"), {})
    stopped = []
    for number, score in enumerate((20.0, 10.0, 21.0, 11.0)):
        study.ask()
        stopped.append(validate(TrialReports(file, number), 0, score))
    assert stopped == [False, True, False, True]


def test_a_repeated_epoch_keeps_its_first_report(tmp_path):
    study = tuning.begin(tmp_path / "study", SETTINGS, {})
    study.ask()
    for score in (20.0, 25.0):
        validate(TrialReports(tmp_path / "study", 0), 0, score)
    assert study.get_trials()[0].intermediate_values == {1: 20.0}


def test_a_job_that_is_no_running_trial_is_refused(tmp_path):
    study_of_two(tmp_path / "study")
    for number in (0, 3):
        with pytest.raises(InputError, match=f"must be its trials; got job {number}"):
            TrialReports(tmp_path / "study", number)
