"""`lfref info`: properties of light fields, the slopes of their scenes, and their defects."""

import json
from pathlib import Path

from omegaconf import DictConfig

from lfref.captures.inspect import Inspection, inspect
from lfref.cli import steps
from lfref.cli.command import command, log
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.report import drawing
from lfref.report.inspection import inspection_sheet

SHEET = "inspection.png"


def info(config: DictConfig, folder: Path) -> None:
    """Log the properties of each light field, and write `inspection.json` and `inspection.png`."""
    fields, flat_field = steps.find_fields(config), steps.flat_field_of(config)
    places = steps.result_folders(config, folder, fields)

    def write(name: str, inspection: Inspection) -> None:
        log.info("%s", "\n".join(inspection.lines()))
        atomic.write_text(places[name] / "inspection.json", json.dumps(inspection.as_dict(), indent=2))
        drawing.save_figure(inspection_sheet(inspection), places[name] / SHEET)
        log.info("open %s", places[name] / SHEET)

    def read(_: str, path: Path) -> LightField:
        return steps.read_field(path, config)

    steps.process(fields, [read, lambda _, field: inspect(field, flat_field), write], "inspecting")


run = command(info)
