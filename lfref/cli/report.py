"""`lfref report`: gather run folders into one page."""

import datetime
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from lfref.cli import config as configs
from lfref.cli.command import command, log, paths
from lfref.errors import InputError
from lfref.report import page, sections, sweeps, tables


def report(config: DictConfig, folder: Path) -> None:
    """Write `index.html`, and CSV files of sweeps; the page and the log name the problems of single runs."""
    runs = paths(configs.plain(config.runs))
    if not runs:
        raise InputError("there must be something to report", remedy="give runs=[FOLDER,...]")
    parts = sections.sections(runs, _sweep_options(config))
    problems = [section.problem for section in parts if section.problem]
    if len(problems) == len(parts):
        raise InputError("no section could be made", got="; ".join(problems))
    for problem in problems:
        log.warning("not shown: %s", problem)
    page.write_page(folder / "index.html", config.title, parts, _facts(runs), config.text)
    for name, table in (pair for section in parts for pair in section.files.items()):
        tables.write_table(_free(folder / name), table)
    log.info("report: %s", (folder / "index.html").resolve())


def _free(path: Path) -> Path:
    """A path that does not exist yet: a second sweep is `sweep_2.csv`."""
    others = (path.with_stem(f"{path.stem}_{number}") for number in itertools.count(2))
    return next(each for each in itertools.chain([path], others) if not each.exists())


def _sweep_options(config: DictConfig) -> sweeps.Options:
    reference = configs.plain(config.reference)
    values = reference if isinstance(reference, list) else [reference]
    texts = None if reference is None else tuple(sweeps.as_text(value) for value in values)
    if not isinstance(config.time, bool):
        raise InputError("time must be true or false", got=repr(config.time))
    return sweeps.Options(texts, config.time, defaults)


def defaults(overrides: Sequence[str]) -> Mapping[str, str]:
    """Values of `lfref train` with these overrides, as text; empty if they do not fit this version of lfref.

    A run folder may come from somebody else: overrides that could make Hydra read other files are left out.
    """
    harmless = [word for word in overrides if "$" not in word and ".." not in word and not word.startswith("hydra")]
    # An entry such as `metrics.x=...` may be one that the run added; `net=refnet` is a choice, which has no dot.
    words = [f"++{word}" if "." in word.partition("=")[0] else word for word in harmless]
    try:
        config = GlobalHydra.instance().config_loader().load_configuration("train", words, RunMode.RUN)
        choices: Any = OmegaConf.to_container(config.hydra.runtime.choices)
        entries: Any = OmegaConf.to_container(config, resolve=False)
    except (HydraException, OmegaConfBaseException):
        return {}
    return sweeps.flat(choices) | sweeps.flat({key: node for key, node in entries.items() if key != "hydra"})


def _facts(runs: list[Path]) -> dict[str, object]:
    """Date of the page, and facts about the machines of the runs and of the jobs of sweeps; all values that differ."""
    facts: dict[str, dict[str, None]] = {}
    for note in (note for run in runs for note in [run / "machine.json", *sorted(run.glob("*/machine.json"))]):
        try:
            for name, value in json.loads(note.read_text("utf-8")).items() if note.is_file() else ():
                facts.setdefault(name, {})[tables.format_cell(name, value)] = None
        except (OSError, ValueError, AttributeError) as error:
            log.warning("%s cannot be read: %s", note, error)
    date = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    return {"date": date, **{name: "; ".join(values) for name, values in facts.items()}}


run = command(report)
