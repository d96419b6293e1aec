"""Configurations: their folder, the objects that they describe, and their copy in a run folder.

`cli.parts` lists the classes and functions that a configuration may name.
"""

import hashlib
import math
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from lfref.cli import parts
from lfref.errors import InputError
from lfref.io import atomic


def directory(name: str = "conf") -> Path:
    """Folder `conf` or `sweeps`: inside an installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / name
    return inside if inside.is_dir() else package.parent / name


def build(config: Any, **arguments: Any) -> Any:
    """The object, mapping or list of objects that a configuration describes; `arguments` are passed on to it."""
    node = plain(config)
    parts.check(node)
    return parts.build(node, **arguments)


def plain(config: Any) -> Any:
    """The configuration as resolved plain containers."""
    if not isinstance(config, DictConfig | ListConfig):
        return config
    missing = sorted(OmegaConf.missing_keys(config))
    if missing:
        remedy = f"add {missing[0]}=VALUE"
        raise InputError("the configuration must be complete", got=f"no {missing[0]}", remedy=remedy)
    try:
        return OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise InputError("the configuration must be complete", got=str(error).splitlines()[0]) from error


def number(config: DictConfig, key: str, least: float, most: float = math.inf) -> Any:
    """The number `config[key]`; refused if it is no finite number from `least` to `most`."""
    value = config[key]
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not (math.isfinite(value) and least <= value <= most)
    ):
        limits = f"of at least {least:g}" if most == math.inf else f"from {least:g} to {most}"
        raise InputError(f"{key} must be a number {limits}", got=repr(value))
    return value


def save(config: DictConfig, folder: Path) -> None:
    """Write the resolved configuration into a run folder as `config.yaml`."""
    atomic.write_text(folder / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(plain(config))))


def fingerprint(config: DictConfig) -> str:
    """Hash of a configuration without its output paths: the same in every process of one run."""
    values = {key: value for key, value in plain(config).items() if key not in ("output", "folder")}
    text = OmegaConf.to_yaml(OmegaConf.create(values), sort_keys=True).replace(str(config.folder), "")
    return hashlib.sha256(text.encode()).hexdigest()
