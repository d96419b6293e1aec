"""`lfref info`: what light fields are, which slopes their scenes occupy, and what is wrong with them."""

import json
from pathlib import Path

from omegaconf import DictConfig

from lfref.captures.inspect import Inspection, inspect
from lfref.cli import inputs
from lfref.cli.command import command, log
from lfref.errors import InputError
from lfref.io import atomic
from lfref.report import drawing
from lfref.report.inspection import inspection_sheet


def info(config: DictConfig, folder: Path) -> None:
    """Say it in lines, and write `inspection.json` and `inspection.png`; of several light fields each gets a folder.

    Args:
        config: `conf/info.yaml`.
        folder: The run folder.
    """
    found = inputs.find(config)
    names = [path.absolute().name if path.is_dir() else path.stem for path in found]
    if len(set(names)) < len(names) or not found:
        raise InputError("inputs must be light fields of different names", got=", ".join(names) or "none")
    white = None if config.white is None else inputs.read(Path(config.white), config)
    for path, name in zip(found, names, strict=True):
        seen = inspect(inputs.read(path, config), white)
        log.info("%s", "\n".join(seen.told()))
        _write(folder if len(found) == 1 else folder / name, seen)
    log.info("inspected: %s", folder)


def _write(folder: Path, seen: Inspection) -> None:
    atomic.write_text(folder / "inspection.json", json.dumps(seen.as_dict(), indent=2))
    drawing.save_figure(inspection_sheet(seen), folder / "inspection.png")


main = command(info)

if __name__ == "__main__":
    main()
