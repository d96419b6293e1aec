"""Parts of installed packages: classes and functions that configurations and checkpoints may name besides lfref's own.

A package declares its parts by entry points of the group `lfref.parts`. `lfref --allow PACKAGE` trusts all public
classes and functions that a package itself defines, for one command. The user decides by installing or by the command
line; no configuration file, run folder or checkpoint can add to these parts.
"""

import difflib
import functools
import importlib
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from lfref.errors import InputError

GROUP = "lfref.parts"
VARIABLE = "LFREF_ALLOW"
"""Environment variable with the allowed packages: child processes of a command (ddp, launchers) inherit it."""
NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+", re.ASCII)
FIXED = {"lfref", "torch", "lightning", "pytorch_lightning", "torchmetrics", "hydra", "omegaconf", "numpy", "wandb"}
"""Packages of which only a fixed table of parts is allowed: some of their functions read and write files."""


def allow(package: str) -> None:
    """Trust the parts that a package defines, in this process and its children.

    Args:
        package: Name of an installed package, such as `mypkg` or `mypkg.nets`.

    Raises:
        InputError: The package is not installed, is one of `FIXED`, or belongs to Python.
    """
    top = package.partition(".")[0]
    if not NAME.fullmatch(f"{package}.x") or top in FIXED or top in sys.stdlib_module_names:
        raise InputError(
            "--allow takes a package of your own", got=repr(package), remedy="give its name: --allow mypkg"
        )
    if importlib.util.find_spec(top) is None:
        raise InputError("--allow takes an installed package", got=package, remedy=f"pip install {top}")
    os.environ[VARIABLE] = ",".join(dict.fromkeys([*allowed(), package]))


def allowed() -> list[str]:
    """Packages that the command line allows."""
    return [package for package in os.environ.get(VARIABLE, "").split(",") if package]


@functools.cache
def declared() -> dict[str, EntryPoint]:
    """Parts that installed packages declare, by full name."""
    return {entry.value.replace(":", "."): entry for entry in entry_points(group=GROUP)}


def is_trusted(name: object) -> bool:
    """Whether a full name such as `mypkg.nets.MyNet` is declared, or lies in an allowed package. Imports nothing."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        return False
    return name in declared() or any(name.startswith(f"{package}.") for package in allowed())


def load(name: str) -> Callable[..., Any]:
    """The class or function of a trusted name.

    Raises:
        InputError: The part is not trusted, missing, or not defined by the allowed package itself.
    """
    if not is_trusted(name):
        raise InputError("a part must be declared by its package or allowed", got=repr(name), remedy=remedy(name))
    module, _, attribute = name.rpartition(".")
    try:
        part = declared()[name].load() if name in declared() else getattr(importlib.import_module(module), attribute)
    except Exception as error:  # the package may raise whatever it likes while it is imported
        raise InputError(f"{name} must be importable", got=f"{type(error).__name__}: {error}") from error
    if not (inspect.isclass(part) or inspect.isfunction(part)):
        raise InputError(f"{name} must be a class or a function", got=type(part).__name__)
    if name not in declared() and (attribute.startswith("_") or not _is_defined_by_allowed(part)):
        raise InputError(f"{name} must be public and defined by an allowed package", got=f"one of {part.__module__}")
    return part


def load_class(path: str) -> Callable[..., Any]:
    """The class defined at `module.qualname`, also if its package declares it by another name, for checkpoints.

    Raises:
        InputError: The class is not trusted, or missing.
    """
    top = path.partition(".")[0]
    for name, entry in declared().items():
        if name.partition(".")[0] == top:
            part = entry.load()
            if f"{part.__module__}.{part.__qualname__}" == path:
                return load(name)
    return load(path)


def _is_defined_by_allowed(part: Callable[..., Any]) -> bool:
    # What a package merely imports, such as mypkg.os.system, is not its own.
    return any(f"{part.__module__}.".startswith(f"{package}.") for package in allowed())


def remedy(name: object) -> str:
    """Advice about a name that is not trusted: the parts that its package declares, or `--allow`."""
    top = str(name).partition(".")[0]
    if not isinstance(name, str) or not NAME.fullmatch(name) or top in FIXED or top in sys.stdlib_module_names:
        return ""
    if importlib.util.find_spec(top) is None:
        return ""
    parts = [part for part in declared() if part.partition(".")[0] == top]
    if parts and top not in allowed():
        near = difflib.get_close_matches(name, parts, 1)
        perhaps = f"perhaps {near[0]}: " if near else ""
        return f"{perhaps}{top} declares {', '.join(sorted(parts))}; lfref --allow {top} trusts all of its classes"
    return f"if you trust {top}, say lfref --allow {top}"
