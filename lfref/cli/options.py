"""Overrides held against what they override: every key is one that exists, flags are flags, numbers are numbers.

Hydra itself would suggest `+key` for a misspelt key, and takes any text for true.
"""

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, ListConfig
from omegaconf.errors import OmegaConfBaseException

from lfref.cli import targets
from lfref.errors import InputError

OF_SEVERAL_KINDS = ("devices", "fast_dev_run", "log_model")
"""Options whose default does not tell what else they may be."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


KINDS: dict[type, tuple[str, Callable[[Any], bool]]] = {
    bool: ("true or false", lambda value: isinstance(value, bool)),
    int: ("a number", _is_number),
    float: ("a number", _is_number),
}


class Place(NamedTuple):
    """Where a key leads: the value there; or the mapping where the way ends, its key, and the name not found in it."""

    value: Any
    above: str = ""
    lost: str | None = None


def check(base: DictConfig, overrides: Iterable[Override], others: Iterable[str]) -> None:
    """Refuse overrides of keys that are not there, or by values of another kind.

    Args:
        base: The configuration before them.
        overrides: Those of single values.
        others: What else could have been meant by a key without dots.

    Raises:
        InputError: The first of them.
    """
    for override in overrides:
        place = find(base, override.key_or_group)
        if place.lost is None:
            _check_kind(override, place.value)
        elif not ((override.is_add() or override.is_force_add()) and place.lost in _addable(place)):
            raise unknown(override.key_or_group, place, others)


def check_groups(base: DictConfig, packages: Mapping[str, str], others: Iterable[str]) -> None:
    """Refuse files added by `+GROUP=NAME` to a place that no command looks at.

    Args:
        base: The configuration without them.
        packages: By key on the command line, where each belongs.
        others: What else could have been meant by a key without dots.

    Raises:
        InputError: The first of them.
    """
    for key, package in packages.items():
        place = find(base, package)
        if place.lost is not None and place.lost not in _addable(place):
            raise unknown(key, place, others)


def find(base: DictConfig, key: str) -> Place:
    """Follow a key such as `data.patch` or `scene.surfaces.0.opacity` as far as it goes."""
    node, above = base, ""
    for name in filter(None, key.split(".")):
        if name not in _names(node):
            return Place(node, above, name)
        node, above = _child(node, name), f"{above}{name}."
    return Place(node)


def unknown(key: str, place: Place, others: Iterable[str] = ()) -> InputError:
    """The error about a key that is not there, with the nearest that is.

    Args:
        key: The whole of it.
        place: Where it led.
        others: What else could have been meant by a key without dots.
    """
    known = [*_names(place.value), *_arguments(place.value), *(() if place.above else others)]
    near = difflib.get_close_matches(str(place.lost), [name for name in known if name[0] != "_"], 1)
    remedy = f"perhaps {place.above}{near[0]}" if near else "--cfg job shows all"
    return InputError("every key must be one of this command", got=repr(key), remedy=remedy)


def _names(node: Any) -> list[str]:
    if isinstance(node, ListConfig):
        return [str(index) for index in range(len(node))]
    return [str(name) for name in node] if isinstance(node, DictConfig) else []


def _child(node: Any, name: str) -> Any:
    try:
        return node[int(name) if isinstance(node, ListConfig) else name]
    except OmegaConfBaseException:  # missing yet, or an interpolation that leads nowhere yet
        return None


def _addable(place: Place) -> list[str]:
    """What may be added with a plus: arguments of a component, or any entry of a mapping of components."""
    children = [_child(place.value, name) for name in _names(place.value)]
    is_open = place.above and isinstance(place.value, DictConfig) and "_target_" not in place.value
    if is_open and all(child is None or isinstance(child, DictConfig) for child in children):
        return [str(place.lost)]
    return _arguments(place.value)


def _arguments(node: Any) -> list[str]:
    target = _child(node, "_target_") if "_target_" in _names(node) else None
    return list(inspect.signature(targets.found(target)).parameters) if target else []


def _check_kind(override: Override, default: Any) -> None:
    key = override.key_or_group
    if (
        override.is_delete()
        or override.is_sweep_override()
        or type(default) not in KINDS
        or key.rpartition(".")[2] in OF_SEVERAL_KINDS
    ):
        return
    value = override.value()
    expected, fits = KINDS[type(default)]
    if not (fits(value) or value is None or "${" in str(value)):
        raise InputError(f"{key} must be {expected}", got=repr(value))
