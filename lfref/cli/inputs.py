"""The light fields that a command is given: found, and read with as many views as its networks want."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli.command import log, paths
from lfref.errors import InputError
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser


def find(config: DictConfig) -> list[Path]:
    """The light fields that `config.input` names, those below a folder of them one by one.

    Raises:
        FileError: There is none.
    """
    return [path for entry in paths(configs.plain(config.input)) for path in reader.find(entry)]


def read(
    path: Path, config: DictConfig, refocusers: Iterable[Refocuser] = (), scratch: Path | None = None
) -> LightField:
    """Read a light field.

    Args:
        path: Where it lies.
        config: Holds `reader`; where it asks for no number of views, networks do.
        refocusers: Who will refocus it.
        scratch: A folder on a disk where its views may lie; None: in memory.

    Raises:
        FileError: It cannot be read.
        InputError: It has not the views that are wanted.
    """
    options = configs.plain(config.reader)
    field = _read(path, options if scratch is None else options | {"scratch": scratch}, refocusers)
    if missing := field.metadata.get("missing"):
        log.info("%s: %s are missing and count for nothing", field.name, missing)
    return field


def _read(path: Path, options: dict[str, Any], refocusers: Iterable[Refocuser]) -> LightField:
    network = next((refocuser for refocuser in refocusers if refocuser.grid is not None), None)
    if options["views"] is not None or network is None:
        return reader.read(path, **options)
    try:
        return reader.read(path, **options | {"views": network.grid})
    except InputError as error:
        raise InputError(f"{network.name} reads {network.grid} views", got=error) from error
