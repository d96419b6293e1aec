"""Trials of a study: its file, the tables of its choices, and the callback by which a training reports to it.

A study is Optuna's. It lies in one file of the sweep's folder, to which all processes append. A job of the sweep is a
trial, and has its number.
The module stands apart from `callbacks`, since only studies need Optuna.
"""

import logging
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import optuna
from lightning.pytorch import Callback, Trainer
from optuna.distributions import BaseDistribution
from optuna.pruners import BasePruner, MedianPruner, NopPruner, SuccessiveHalvingPruner
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.study import StudyDirection
from optuna.trial import TrialState

from lfref.errors import FileError, InputError, chosen, first_line

log = logging.getLogger(__name__)
optuna.logging.set_verbosity(optuna.logging.WARNING)

NAME = "lfref"
"""Name of the study in its file, which holds no other."""
SETTINGS = "settings"
"""Attribute of a study: what its trials have in common."""
REASON = "reason"
"""Attribute of a failed trial."""


class Settings(NamedTuple):
    """How a study chooses its trials; a study that goes on keeps its settings."""

    sampler: str
    """A key of `SAMPLERS`."""
    n_random: int
    """Number of finished trials that `tpe` needs before it learns from them."""
    seed: int
    pruner: str
    """A key of `PRUNERS`."""
    n_unpruned: int
    """Number of finished trials that `median` needs before it stops others."""
    warmup_epochs: int
    """Number of epochs of each trial before a pruner may stop it."""
    monitor: str
    """The metric, as it is logged."""
    mode: str
    """`max` or `min`."""


SAMPLERS: dict[str, Callable[[Settings, int], BaseSampler]] = {
    "tpe": lambda settings, seed: TPESampler(n_startup_trials=settings.n_random, seed=seed),
    "random": lambda settings, seed: RandomSampler(seed=seed),
}
"""Name -> function of settings and seed; all that a sampler remembers must lie in the study."""
# Trials report after each epoch, and the first epoch is step 1.
PRUNERS: dict[str, Callable[[Settings], BasePruner]] = {
    "median": lambda settings: MedianPruner(settings.n_unpruned, n_warmup_steps=settings.warmup_epochs + 1),
    "halving": lambda settings: SuccessiveHalvingPruner(min_resource=settings.warmup_epochs + 1),
    "none": lambda settings: NopPruner(),
}


def begin(file: Path, settings: Settings, common: Mapping[str, Any]) -> optuna.Study:
    """Open the study of a file, or begin it.

    Args:
        file: The file of the study.
        settings: Its settings.
        common: What the trials have in common besides, in plain containers: a study that goes on must have the same.

    Raises:
        InputError: A setting is none of the choices, or the file holds a study with other settings.
        FileError: The file is damaged.
    """
    chosen("tune.sampler", settings.sampler, SAMPLERS)
    pruner = chosen("tune.pruner", settings.pruner, PRUNERS)(settings)
    direction = StudyDirection.MAXIMIZE if settings.mode == "max" else StudyDirection.MINIMIZE
    study = _opened(
        lambda storage: optuna.create_study(
            storage=storage, study_name=NAME, direction=direction, pruner=pruner, load_if_exists=True
        ),
        file,
    )
    expected = {**settings._asdict(), **common}
    kept = study.user_attrs.get(SETTINGS)
    if kept is None:
        study.set_user_attr(SETTINGS, expected)
        return study
    changes = [f"{key}={value} instead of {kept.get(key)}" for key, value in expected.items() if value != kept.get(key)]
    if changes:
        remedy = "give the command of its beginning, or another output"
        raise InputError("a study must go on with the same settings", got="; ".join(changes), remedy=remedy)
    return study


def opened(file: Path) -> optuna.Study:
    """The study of a file, with its pruner; FileError if it is damaged."""
    study = _opened(lambda storage: optuna.load_study(storage=storage, study_name=NAME, sampler=RandomSampler()), file)
    kept = study.user_attrs[SETTINGS]
    settings = Settings(**{name: kept[name] for name in Settings._fields})
    study.pruner = PRUNERS[settings.pruner](settings)
    return study


def _opened(make: Callable[[JournalStorage], optuna.Study], file: Path) -> optuna.Study:
    try:
        return make(JournalStorage(JournalFileBackend(str(file))))
    except Exception as error:  # the file may hold anything
        remedy = "choose another output, or delete the file to begin anew"
        raise FileError(f"{file} must be a study", got=first_line(error), remedy=remedy) from error


def draw(study: optuna.Study, settings: Settings, space: Mapping[str, BaseDistribution], number: int) -> dict[str, Any]:
    """The parameters of a trial that was asked for: new ones, or those that it has.

    The sampler gets a seed of its own for each trial, so that a study that was interrupted draws the same trials as one
    that was not.

    Args:
        study: The study.
        settings: Its settings.
        space: Name of each parameter -> its distribution.
        number: Number of the trial.
    """
    (seed,) = np.random.SeedSequence((settings.seed, number)).generate_state(1)
    study.sampler = SAMPLERS[settings.sampler](settings, int(seed))
    trial = _running(study, number)
    # `Study.ask` does the same for a new trial; a process that was killed there has left some parameters.
    return {name: trial._suggest(name, distribution) for name, distribution in space.items()}


def tell(study: optuna.Study, number: int, value: float | None, reason: str) -> None:
    """Finish a trial: with its value, or if it has none as a failed one; a pruned trial is finished already."""
    if study.get_trials(deepcopy=False)[number].state.is_finished():
        return
    if value is None or np.isnan(value):
        _running(study, number).set_user_attr(REASON, reason)
        study.tell(number, state=TrialState.FAIL)
    else:
        study.tell(number, value)


def _running(study: optuna.Study, number: int) -> optuna.Trial:
    """A running trial, also one that another process has begun; Optuna has no public way to it."""
    return optuna.Trial(study, study.get_trials(deepcopy=False)[number]._trial_id)


class TrialReports(Callback):
    """Reports each validation of a training to its trial, and ends the training if the study's pruner says so.

    Args:
        file: The file of the study.
        number: Number of the trial.
    """

    def __init__(self, file: Path, number: int) -> None:
        self.study = opened(file)
        self.number = number
        self.monitor: str = self.study.user_attrs[SETTINGS]["monitor"]
        self.is_pruned = False
        """Whether the training ends early."""
        running = [trial.number for trial in self.study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))]
        if number not in running:
            remedy = "give another output"
            raise InputError("jobs in the folder of a study must be its trials", got=f"job {number}", remedy=remedy)

    def on_validation_end(self, trainer: Trainer, module: Any) -> None:
        """Report, and ask whether to go on; the last epoch of a training is never pruned."""
        value = trainer.callback_metrics.get(self.monitor)
        if trainer.sanity_checking or value is None:
            return
        trial, epoch = _running(self.study, self.number), trainer.current_epoch + 1
        with warnings.catch_warnings():
            # An epoch that a resumed training repeats has reported already; the first report stays.
            warnings.simplefilter("ignore")
            trial.report(float(value), epoch)
        is_last = trainer.max_epochs is not None and epoch == trainer.max_epochs
        if not is_last and trial.should_prune():
            log.info("pruned after epoch %d: %s %.4g", epoch, self.monitor, float(value))
            self.is_pruned = trainer.should_stop = True

    def on_train_end(self, trainer: Trainer, module: Any) -> None:
        """Finish the trial in the study if it was pruned."""
        if self.is_pruned:
            self.study.tell(self.number, state=TrialState.PRUNED)
