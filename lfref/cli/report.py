"""`lfref report`: gather run folders into one page."""

import datetime
import json
from pathlib import Path

from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli.command import command, log, paths
from lfref.errors import InputError
from lfref.report import page, sections


def report(config: DictConfig, folder: Path) -> None:
    """Write `index.html`; the page and the log name the problems of single runs."""
    runs = paths(configs.plain(config.runs))
    if not runs:
        raise InputError("there must be something to report", remedy="give runs=[FOLDER,...]")
    parts = sections.sections(runs)
    problems = [section.problem for section in parts if section.problem]
    if len(problems) == len(parts):
        raise InputError("no section could be made", got="; ".join(problems))
    for problem in problems:
        log.warning("not shown: %s", problem)
    page.write_page(folder / "index.html", config.title, parts, _facts(runs))
    log.info("report: %s", (folder / "index.html").resolve())


def _facts(runs: list[Path]) -> dict[str, object]:
    """Date of the page, and facts about the machines of the runs."""
    facts: dict[str, object] = {"date": datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")}
    for note in (run / "machine.json" for run in runs if (run / "machine.json").is_file()):
        try:
            facts |= json.loads(note.read_text("utf-8"))
        except (OSError, ValueError, TypeError) as error:
            log.warning("%s cannot be read: %s", note, error)
    return facts


main = command(report)
