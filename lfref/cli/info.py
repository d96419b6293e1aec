"""`lfref info`: what light fields are, which slopes their scenes occupy, and what is wrong with them."""

import json
from pathlib import Path

from omegaconf import DictConfig

from lfref.captures.inspect import Inspection, inspect
from lfref.cli import config as configs
from lfref.cli import inputs, result_folders
from lfref.cli.command import command, log, paths
from lfref.io import atomic
from lfref.report import drawing
from lfref.report.inspection import inspection_sheet


def info(config: DictConfig, folder: Path) -> None:
    """Say it in lines, and write `inspection.json` and `inspection.png`; of several, each gets a folder of its name.

    Args:
        config: `conf/info.yaml`.
        folder: The run folder.
    """
    given = paths(configs.plain(config.input))
    captures = inputs.found(given, config.reader.pattern)
    white = None if config.white is None else inputs.read(Path(config.white), config)

    def one(name: str, path: Path) -> None:
        seen = inspect(inputs.read(path, config), white)
        log.info("%s", "\n".join(seen.lines()))
        _write(result_folders.of(folder, name, path, given), seen)

    inputs.each(captures, [one], "inspecting")
    log.info("inspected: %s", folder)


def _write(folder: Path, seen: Inspection) -> None:
    atomic.write_text(folder / "inspection.json", json.dumps(seen.as_dict(), indent=2))
    drawing.save_figure(inspection_sheet(seen), folder / "inspection.png")


main = command(info)

if __name__ == "__main__":
    main()
