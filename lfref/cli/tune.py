"""`lfref tune`: search the options of `lfref train` by trials, which are jobs of a sweep that asks Optuna for them.

Hydra launches the trials in batches, by any of its launchers. Each is an ordinary run of `lfref train` in a folder of
its own; `lfref.train.tuning` keeps the study.
"""

import copy
import csv
import io
import json
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import optuna
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override, RangeSweep
from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf, read_write
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState

from lfref.cli import composition, resume
from lfref.cli import config as configs
from lfref.cli.command import command
from lfref.cli.exit_codes import fail
from lfref.cli.train import prepare, score, train
from lfref.errors import InputError, LfrefError, counted, first_line
from lfref.io import atomic
from lfref.io import run as runs
from lfref.train import tuning

TABLE, BEST = "trials.csv", "experiment/best.yaml"
"""Files in the folder of a study, besides those of the trials."""
STATES = {
    TrialState.COMPLETE: "finished",
    TrialState.PRUNED: "pruned",
    TrialState.FAIL: "failed",
    TrialState.RUNNING: "running",
    TrialState.WAITING: "waiting",
}
OWN = ("tune", *resume.FOLDERS)
"""Options that trials do not get."""
RANGE = {"low", "high", "log", "step"}
"""Keys of a range in `tune.space`."""
PLAIN = re.compile(r"(?!(?:true|false|null|nan|inf)$)[a-z_][\w./-]*", re.IGNORECASE)
"""Text that Hydra reads as it stands."""


# The space.


def search_space(node: Mapping[str, Any], sweeps: Sequence[Override]) -> dict[str, BaseDistribution]:
    """The distribution of each option.

    Args:
        node: `tune.space`, in plain containers: option -> list of choices, or range {low, high, log, step}.
        sweeps: Overrides such as `net.n_blocks=3,5,7` or `optimizer.lr=interval(1e-4,1e-2)`, which take precedence.

    Raises:
        InputError: An entry is neither, or there is none.
    """
    space = {option: _distribution(option, entry) for option, entry in _entries(node)}
    space |= {override.get_key_element(): _distribution_of_sweep(override) for override in sweeps}
    if not space:
        remedy = "give tune.space={optimizer.lr:{low:1e-4,high:1e-2,log:true}}"
        raise InputError("tune.space must name the options to search", got="none", remedy=remedy)
    return dict(sorted(space.items()))  # the overrides of a trial that goes on must stand in the same order


def _entries(node: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Options with their choices or range; a nested mapping is as good as a key with dots."""
    for key, entry in node.items():
        if isinstance(entry, dict) and not RANGE & {*entry}:
            yield from _entries(entry, f"{above}{key}.")
        else:
            yield f"{above}{key}", entry


def _distribution(option: str, entry: Any) -> BaseDistribution:
    if isinstance(entry, list) and entry:
        return CategoricalDistribution([_text(choice) for choice in entry])
    numbers = [entry[key] for key in ("low", "high", "step") if entry.get(key) is not None] if _is_range(entry) else []
    if not numbers or not all(isinstance(number, int | float) for number in numbers):
        expected = f"tune.space.{option} must be a list of choices, or a range with numbers low and high"
        raise InputError(expected, got=entry, remedy="write [relu,gelu], or {low:1e-4,high:1e-2,log:true}")
    return _range(option, entry["low"], entry["high"], entry.get("step"), bool(entry.get("log")))


def _is_range(entry: Any) -> bool:
    return isinstance(entry, dict) and {"low", "high"} <= {*entry} <= RANGE


def _range(option: str, low: float, high: float, step: float | None = None, log: bool = False) -> BaseDistribution:
    """Whole numbers if all of its numbers are whole, else any."""
    try:
        if all(isinstance(number, int) for number in (low, high, 1 if step is None else step)):
            return IntDistribution(int(low), int(high), log, 1 if step is None else int(step))
        return FloatDistribution(low, high, log, step)
    except ValueError as error:
        got = f"{low} to {high}: {first_line(error)}"
        raise InputError(f"the range of {option} must be one that can be searched", got=got) from error


def _distribution_of_sweep(override: Override) -> BaseDistribution:
    sweep, option = override.value(), override.get_key_element()
    is_log = isinstance(sweep, ChoiceSweep | IntervalSweep | RangeSweep) and "log" in sweep.tags
    if isinstance(sweep, IntervalSweep):
        assert sweep.start is not None, "Hydra's grammar asks for both"
        assert sweep.end is not None, "Hydra's grammar asks for both"
        return _range(option, sweep.start, sweep.end, log=is_log)
    if isinstance(sweep, RangeSweep) and sweep.start is not None and sweep.stop is not None:
        # The stop of a range does not belong to it.
        values = list(sweep.range())
        if not values:
            raise InputError(f"the range of {option} must hold numbers", got=override.input_line)
        return _range(option, values[0], values[-1], None if is_log else sweep.step, is_log)
    return CategoricalDistribution(list(override.sweep_string_iterator()))


def _text(value: Any) -> str:
    """A value as Hydra reads it on a command line."""
    if not isinstance(value, str):
        return json.dumps(value, separators=(",", ":"))
    return value if PLAIN.fullmatch(value) else resume.quoted(value)


# The sweeper.


class AskAndTell(Sweeper):
    """Launches the trials of a study in batches.

    Args:
        max_batch_size: Stands in Hydra's own settings of sweepers; `tune.parallel` takes its place.
        params: Further overrides, which stand before those of the command line.
    """

    config: DictConfig
    hydra_context: HydraContext
    launcher: Launcher

    def __init__(self, max_batch_size: int | None = None, params: dict[str, str] | None = None) -> None:
        self.params = params or {}

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Make the launcher; its jobs are those of `lfref train`, and know nothing of `tune`."""
        self.folder = Path(config.hydra.sweep.dir).absolute()
        self.hydra_context, self.config = hydra_context, copy.deepcopy(config)
        with read_write(self.config.hydra.job):
            self.config.hydra.job.config_name = "train"
        self.launcher = Plugins.instance().instantiate_launcher(hydra_context, task_function, self.config)

    def sweep(self, arguments: list[str]) -> None:
        """Run trials until there are as many as configured, and write what came out of them."""
        try:
            self._sweep([*(f"{key}={value}" for key, value in self.params.items()), *arguments])
        except LfrefError as error:
            fail("tune", error)

    def _sweep(self, arguments: list[str]) -> None:
        tune = configs.plain(self.config.tune)
        overrides = OverridesParser.create(self.hydra_context.config_loader).parse_overrides(arguments)
        own = [item for item in overrides if item.key_or_group.partition(".")[0] not in OWN]
        self.space = search_space(tune["space"] or {}, [item for item in own if item.is_sweep_override()])
        fixed = [item for item in own if not item.is_sweep_override() and item.get_key_element() not in self.space]
        self.words = [str(item.input_line) for item in fixed]
        n_trials, n_parallel = _count(tune, "n_trials"), _count(tune, "parallel")
        self.settings = _settings(tune, configs.plain(self.config.callbacks))
        _check_trainer(configs.plain(self.config.trainer))
        self._check_space()
        space = {option: optuna.distributions.distribution_to_json(item) for option, item in self.space.items()}
        common = {"options": self.words, "space": space}
        self.study = tuning.begin(self.folder / runs.STUDY, self.settings, common)
        for numbers in self._batches(n_trials, n_parallel):
            self._launch(numbers)
            _write_table(self.folder / TABLE, self.study, self.settings.monitor)
        self._finish()

    def _check_space(self) -> None:
        """Compose trainings with all choices and the ends of all ranges: a misspelt option ends the study at once."""
        ends = {option: _ends(distribution) for option, distribution in self.space.items()}
        for index in range(max(map(len, ends.values()))):
            values = {option: values[index % len(values)] for option, values in ends.items()}
            self.validate_batch_is_legal([self._overrides(values)])

    def _overrides(self, parameters: Mapping[str, Any]) -> list[str]:
        """Overrides of a training with these parameters."""
        return [*self.words, *_words(parameters), f"output={resume.quoted(self.folder)}", "hydra.job.name=train"]

    def _batches(self, n_trials: int, n_parallel: int) -> Iterator[list[int]]:
        """Numbers of the trials to launch together: interrupted ones first, then new ones."""
        running = self.study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
        yield from _consecutive([trial.number for trial in running], n_parallel)
        while (n_left := n_trials - len(self.study.get_trials(deepcopy=False))) > 0:
            yield [self.study.ask().number for _ in range(min(n_left, n_parallel))]

    def _launch(self, numbers: Sequence[int]) -> None:
        """Run a batch of trials with consecutive numbers, and tell the study what came out of each."""
        batch = [self._overrides(tuning.draw(self.study, self.settings, self.space, number)) for number in numbers]
        for number in numbers:
            self._note(number).unlink(missing_ok=True)
        try:
            jobs = self.launcher.launch(batch, initial_job_idx=numbers[0])
        except Exception as error:  # such as the death of a process that the launcher started
            remedy = f"the same command with output={self.folder} goes on"
            expected = "the launcher must bring its jobs to an end"
            raise LfrefError(expected, got=first_line(error), remedy=remedy) from error
        for number, job in zip(numbers, jobs, strict=True):
            tuning.tell(self.study, number, job.return_value, self._reason(number))

    def _note(self, number: int) -> Path:
        return self.folder / str(number) / resume.FAILURE

    def _reason(self, number: int) -> str:
        """Why a trial has no value; its note goes, since a failed trial is no failure of the study."""
        note = self._note(number)
        if not note.is_file():
            return f"no validation with a finite {self.settings.monitor}"
        reason = json.loads(note.read_text("utf-8"))["reason"]
        note.unlink()
        return str(reason)

    def _finish(self) -> None:
        """Write the table and the best options, and print them."""
        _write_table(self.folder / TABLE, self.study, self.settings.monitor)
        done = self.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if not done:
            remedy = f"see {self.folder / TABLE} for the reasons, and search other values"
            raise LfrefError("a study must have a trial that succeeds", got="none", remedy=remedy)
        best = self.study.best_trial
        loader = self.hydra_context.config_loader
        groups = [option for option in best.params if loader.get_group_options(option)]
        atomic.write_text(self.folder / BEST, _experiment(best.params, groups))
        states = [trial.state for trial in self.study.get_trials(deepcopy=False)]
        counts = ", ".join(f"{states.count(state)} {name}" for state, name in STATES.items() if state in states)
        print(f"{counted(len(states), 'trial')} ({counts}): {self.folder / TABLE}")
        print(f"best {self.settings.monitor} {best.value:.4g} by trial {best.number}; to train with its options:")
        print("lfref train", shlex.join([*self.words, *_words(best.params)]))


def _settings(tune: Mapping[str, Any], callbacks: Mapping[str, Any]) -> tuning.Settings:
    best = callbacks.get("best")
    if not best:
        raise InputError("callbacks.best must say what a study searches for", got="null", remedy="leave it as it is")
    numbers = {key: _count(tune, key, 0) for key in ("n_random", "seed", "n_unpruned", "warmup_epochs")}
    return tuning.Settings(
        sampler=tune["sampler"], pruner=tune["pruner"], monitor=best["monitor"], mode=best["mode"], **numbers
    )


def _check_trainer(trainer: Mapping[str, Any]) -> None:
    """Refuse trials in several processes, each of which would run the study."""
    devices = trainer.get("devices")
    is_one = devices in (1, "1") or (isinstance(devices, list) and len(devices) == 1)
    if not is_one or "ddp" in str(trainer.get("strategy")):
        got = f"trainer.devices={devices}"
        raise InputError("each trial must take one device", got=got, remedy="give trainer=gpu or trainer=cpu")


def _count(tune: Mapping[str, Any], key: str, least: int = 1) -> int:
    value = tune[key]
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InputError(f"tune.{key} must be a whole number of at least {least}", got=repr(value))
    return value


def _ends(distribution: BaseDistribution) -> list[Any]:
    """All choices, or the ends of a range."""
    if isinstance(distribution, CategoricalDistribution):
        return list(distribution.choices)
    assert isinstance(distribution, IntDistribution | FloatDistribution)
    return [distribution.low, distribution.high]


def _words(parameters: Mapping[str, Any]) -> list[str]:
    return [f"{option}={value}" for option, value in parameters.items()]


def _consecutive(numbers: Sequence[int], most: int) -> Iterator[list[int]]:
    """Batches of consecutive numbers, as launchers count their jobs, of at most so many."""
    batch: list[int] = []
    for number in numbers:
        if batch and (len(batch) == most or number != batch[-1] + 1):
            yield batch
            batch = []
        batch.append(number)
    if batch:
        yield batch


def _write_table(path: Path, study: optuna.Study, monitor: str) -> None:
    """Write a table of all trials."""
    rows = [_row(trial, monitor) for trial in study.get_trials(deepcopy=False)]
    file = io.StringIO(newline="")
    writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
    writer.writeheader()
    writer.writerows(rows)
    atomic.write_text(path, file.getvalue())


def _row(trial: FrozenTrial, monitor: str) -> dict[str, Any]:
    first = {"trial": trial.number, "state": STATES[trial.state], monitor: trial.value}
    last = {"epochs": trial.last_step, "reason": trial.user_attrs.get(tuning.REASON)}
    return {**first, **trial.params, **last}


def _experiment(parameters: Mapping[str, Any], groups: Sequence[str]) -> str:
    """The text of an experiment's configuration with these parameters; groups are options that choose a file."""
    choices = [{f"override /{group}": str(parameters[group])} for group in groups]
    values = OverridesParser.create().parse_overrides(
        _words({option: value for option, value in parameters.items() if option not in groups})
    )
    tree = OmegaConf.create()
    for item in values:
        OmegaConf.update(tree, item.key_or_group, item.value(), force_add=True)
    head = "# @package _global_\n# The best trial of a study: lfref train --config-dir STUDY experiment=best\n"
    return head + yaml.safe_dump(({"defaults": choices} if choices else {}) | configs.plain(tree), sort_keys=False)


# The command.


def tune(config: DictConfig, folder: Path) -> None:
    """Train one trial; its module gives the command its name."""
    train(config, folder)


def _own_words(words: list[str]) -> list[str]:
    """The command line, if it says nothing that a study decides."""
    for word in words:
        if word.startswith("resume="):
            remedy = "repeat its command with output=STUDY"
            raise InputError("a study goes on by its command, not by resume", got=repr(word), remedy=remedy)
        if resume.key_of(word) in ("hydra/sweeper", "hydra.sweeper", "hydra.sweeper._target_"):
            raise InputError("the sweeper of a study must be left as it is", got=repr(word))
    return words


_run = command(tune, prepare, _own_words, score)


def main() -> None:
    """Let Hydra find our sweeper, and start."""
    # Hydra looks up sweepers by name, which must lie in the package `hydra_plugins`.
    Plugins.instance().class_name_to_class[composition.SWEEPER] = AskAndTell
    _run()
