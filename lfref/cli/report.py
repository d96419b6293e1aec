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
    """Write `index.html`.

    Args:
        config: `conf/report.yaml`.
        folder: The run folder.
    """
    runs = paths(configs.plain(config.runs))
    if not runs:
        raise InputError("there must be something to report", remedy="give runs=[FOLDER,...]")
    facts: dict[str, object] = {"made": datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")}
    for note in (run / "machine.json" for run in runs):
        if note.is_file():
            facts |= json.loads(note.read_text("utf-8"))
    page.write_page(folder / "index.html", config.title, sections.sections(runs), facts)
    log.info("report: %s", (folder / "index.html").resolve())


main = command(report)
