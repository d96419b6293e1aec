"""Ablations as one file for two runners: `sweeps/NAME.yaml` is a wandb sweep, and Hydra's multirun reads it too.

`lfref train --multirun +sweep=NAME` becomes one override a parameter, `key=a,b,c`, before Hydra sees the line.
"""

from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from lfref.errors import InputError


def overrides(name: str, folder: Path) -> list[str]:
    """Hydra overrides `key=a,b,c` of a sweep.

    Args:
        name: Stem of its file.
        folder: Where the sweeps lie.

    Raises:
        InputError: No such sweep, or a file that is none.
    """
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise InputError(f"sweep must be one of {', '.join(known)}", got=repr(name))
    try:
        parameters: Any = OmegaConf.to_container(OmegaConf.load(folder / f"{name}.yaml"))
        return [f"{key}={','.join(map(str, entry['values']))}" for key, entry in parameters["parameters"].items()]
    except (KeyError, TypeError, AttributeError, YAMLError, OmegaConfBaseException) as error:
        raise InputError(f"sweep {name} must hold parameters with a list of values each", got=error) from error
