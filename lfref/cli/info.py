"""`lfref info`: properties of light fields, the slopes of their scenes, and their defects."""

import json
from pathlib import Path

from omegaconf import DictConfig

from lfref.captures.inspect import Inspection, inspect
from lfref.cli import config as configs
from lfref.cli import steps
from lfref.cli.command import command, log, paths
from lfref.io import atomic
from lfref.report import drawing
from lfref.report.inspection import inspection_sheet


def info(config: DictConfig, folder: Path) -> None:
    """Log the properties of each light field, and write `inspection.json` and `inspection.png`."""
    fields, named = steps.find_fields(config), paths(configs.plain(config.input))
    white = None if config.white is None else steps.read_field(Path(config.white), config)

    def inspect_field(name: str, path: Path) -> None:
        inspection = inspect(steps.read_field(path, config), white)
        log.info("%s", "\n".join(inspection.lines()))
        _write(steps.result_folder(folder, name, path, named), inspection)

    steps.process(fields, [inspect_field], "inspecting")
    log.info("inspected: %s", folder)


def _write(folder: Path, inspection: Inspection) -> None:
    atomic.write_text(folder / "inspection.json", json.dumps(inspection.as_dict(), indent=2))
    drawing.save_figure(inspection_sheet(inspection), folder / "inspection.png")


main = command(info)

if __name__ == "__main__":
    main()
