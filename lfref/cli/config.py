"""Configuration: where it lies, how it becomes objects, and how it is kept beside what it made.

Only names of our own, of Lightning and of torch's optimisers may be instantiated: a `_target_` can name any callable,
and Hydra lets dangerous ones through.
"""

import hashlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hydra.utils
from hydra.errors import InstantiationException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from lfref.errors import InputError, LfrefError
from lfref.io import atomic

ALLOWED = ("lfref.", "lightning.pytorch.", "torch.optim.")


def directory(name: str = "conf") -> Path:
    """Folder `conf` or `sweeps`: inside an installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / name
    return inside if inside.is_dir() else package.parent / name


def build(config: Any, **arguments: Any) -> Any:
    """Make the object that a configuration describes.

    Args:
        config: A node with `_target_`, or a mapping or list of such nodes.
        **arguments: Further arguments for the object, made already.

    Raises:
        InputError: A `_target_` that is not allowed, or arguments that do not fit it.
        LfrefError: As the object raises it.
    """
    for target in _targets(plain(config)):
        if not target.startswith(ALLOWED):
            raise InputError(f"_target_ must begin with one of {', '.join(ALLOWED)}", got=repr(target))
    try:
        return hydra.utils.instantiate(config, **arguments, _convert_="all")
    except InstantiationException as error:
        if isinstance(error.__cause__, LfrefError):
            raise error.__cause__ from None
        raise InputError(
            "the configuration must fit what it describes", got=_first_line(error.__cause__ or error)
        ) from error


def plain(config: Any) -> Any:
    """The configuration as resolved plain containers.

    Raises:
        InputError: A value that is mandatory is missing, or an interpolation leads nowhere.
    """
    if not isinstance(config, DictConfig | ListConfig):
        return config
    try:
        return OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise InputError(
            "the configuration must be complete", got=_first_line(error), remedy="add KEY=VALUE"
        ) from error


def number(config: DictConfig, key: str, least: float) -> Any:
    """A number of the configuration, once it is known to be one.

    Args:
        config: Where it stands.
        key: Its name.
        least: The smallest that is allowed.

    Raises:
        InputError: It is no number, or smaller.
    """
    value = config[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < math.inf:
        raise InputError(f"{key} must be a number of at least {least:g}", got=repr(value))
    return value


def save(config: DictConfig, folder: Path) -> None:
    """Write the resolved configuration into a run folder as `config.yaml`."""
    atomic.write_text(folder / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(plain(config))))


def fingerprint(config: DictConfig) -> str:
    """Hash of a configuration, its output paths left out: the same in every process of one run."""
    values = {key: value for key, value in plain(config).items() if key not in ("output", "folder")}
    text = OmegaConf.to_yaml(OmegaConf.create(values), sort_keys=True).replace(str(config.folder), "")
    return hashlib.sha256(text.encode()).hexdigest()


def _targets(node: Any) -> Iterator[str]:
    children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    if isinstance(node, dict) and "_target_" in node:
        yield str(node["_target_"])
    for child in children:
        yield from _targets(child)


def _first_line(error: object) -> str:
    return str(error).strip().splitlines()[0]
