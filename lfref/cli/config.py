"""Configurations: their folder, the objects that they describe, and their copy in a run folder."""

import hashlib
from pathlib import Path
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from lfref.errors import InputError, LfrefError
from lfref.io import atomic


def directory(name: str = "conf") -> Path:
    """Folder `conf` or `sweeps`: inside an installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / name
    return inside if inside.is_dir() else package.parent / name


def build(config: Any, **arguments: Any) -> Any:
    """The objects that a configuration describes, whose `_target_` is imported and called with these arguments."""
    node: Any = plain(config)
    if not isinstance(node, dict | list):
        return node
    try:
        if not arguments or isinstance(node, list):
            return instantiate(node, _convert_="all")
        # Hydra would merge arguments into the configuration, where dataclasses lose their class.
        others = {key: value for key, value in node.items() if key not in arguments}
        return instantiate(others | {"_partial_": True}, _convert_="all")(**arguments)
    except InstantiationException as error:
        if isinstance(error.__cause__, LfrefError):
            raise error.__cause__ from None
        raise InputError("the configuration must fit what it describes", got=" ".join(str(error).split())) from error


def plain(config: Any) -> Any:
    """The configuration as resolved plain containers."""
    if not isinstance(config, DictConfig | ListConfig):
        return config
    try:
        return OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise InputError("the configuration must be complete", got=error) from error


def save(config: DictConfig, folder: Path) -> None:
    """Write the resolved configuration into a run folder as `config.yaml`."""
    atomic.write_text(folder / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(plain(config))))


def fingerprint(config: DictConfig) -> str:
    """Hash of a configuration without its output paths: the same in every process of one run."""
    values = {key: value for key, value in plain(config).items() if key not in ("output", "folder")}
    text = OmegaConf.to_yaml(OmegaConf.create(values), sort_keys=True).replace(str(config.folder), "")
    return hashlib.sha256(text.encode()).hexdigest()
