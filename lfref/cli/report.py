"""`lfref report`: gather run folders into one page."""

import datetime
import itertools
import json
from pathlib import Path

from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli.command import command, log, paths
from lfref.errors import InputError
from lfref.report import page, sections, tables


def report(config: DictConfig, folder: Path) -> None:
    """Write `index.html`, and CSV files of sweeps."""
    runs = paths(configs.plain(config.runs))
    if not runs:
        raise InputError("there must be something to report", remedy="give runs=[FOLDER,...]")
    parts = sections.sections(runs)
    page.write_page(folder / "index.html", config.title, parts, _facts(runs), config.text)
    for name, table in (pair for section in parts for pair in section.files.items()):
        tables.write_table(_free(folder / name), table)
    log.info("report: %s", (folder / "index.html").resolve())


def _free(path: Path) -> Path:
    """A path that does not exist yet: a second sweep is `sweep_2.csv`."""
    others = (path.with_stem(f"{path.stem}_{number}") for number in itertools.count(2))
    return next(each for each in itertools.chain([path], others) if not each.exists())


def _facts(runs: list[Path]) -> dict[str, object]:
    """Date of the page, and facts about the machines of the runs and of the jobs of sweeps; all values that differ."""
    facts: dict[str, dict[str, None]] = {}
    for note in (note for run in runs for note in [run / "machine.json", *sorted(run.glob("*/machine.json"))]):
        for name, value in json.loads(note.read_text("utf-8")).items() if note.is_file() else ():
            facts.setdefault(name, {})[tables.format_cell(name, value)] = None
    date = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    return {"date": date, **{name: "; ".join(values) for name, values in facts.items()}}


run = command(report)
