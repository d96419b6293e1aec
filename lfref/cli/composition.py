"""Composition of configurations by Hydra, with our checks before anything is built from them.

1. `hydra.*` is held to tables (`check`): Hydra builds callbacks, launchers, sweepers and log handlers from it, some
   before a command starts.
2. Overrides must fit what they override (`check_overrides`, `check_groups`): every key exists, flags are flags, numbers
   are numbers. Hydra itself would suggest `+key` for a misspelt key, and takes any text for true.
3. `CheckedLoader` runs both on every composition, those of `--help` and of each job of a sweep included.

Private names of Hydra in use, since public Hydra has no hook between composing and acting on the result:
`hydra._internal.config_loader_impl.ConfigLoaderImpl` (`_process_config_searchpath`, before packages on a search path
are imported; `_compose_config_from_defaults_list`, before overrides are merged) and `hydra._internal.hydra`, where it
is replaced while a command runs. The targets of launchers and sweepers are private names of Hydra too, as Hydra names
them.
"""

import difflib
import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

from hydra._internal import hydra as runner
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.override_parser.types import Override
from hydra.core.utils import JobRuntime
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from lfref.cli import exit_codes, parts
from lfref.cli.arguments import SHORTHANDS
from lfref.errors import InputError, LfrefError

RENAMED = {
    "guides": "features", "n_guides": "n_features", "n_offers": "n_candidates",
    "fourier_slice_wide": "fourier_slice", "fourier_slice_linear_padded": "fourier_slice",
}  # fmt: skip
"""Keys and choices of earlier versions -> today's, which the error about an unknown one names."""

# 1. Settings of Hydra itself: enough to launch and sweep, nothing that runs or opens what it names. Values are checked
# as written, before interpolation: an interpolation could become anything later.

CALLBACKS = ("lfref.cli.run_folder.OutputFolder",)
QUEUE = (
    "submitit_folder", "timeout_min", "cpus_per_task", "gpus_per_node", "tasks_per_node", "mem_gb", "nodes", "name",
    "stderr_to_stdout",
)  # fmt: skip
LAUNCHERS: dict[str, tuple[str, ...]] = {
    "hydra._internal.core_plugins.basic_launcher.BasicLauncher": (),
    "hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher": (
        "n_jobs", "prefer", "require", "verbose", "timeout", "batch_size", "max_nbytes", "mmap_mode",
    ),
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.LocalLauncher": QUEUE,
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher": (
        *QUEUE, "partition", "qos", "comment", "constraint", "exclude", "gres", "cpus_per_gpu", "gpus_per_task",
        "mem_per_gpu", "mem_per_cpu", "account", "signal_delay_s", "max_num_timeout", "array_parallelism",
    ),
    "hydra_plugins.hydra_ray_launcher.ray_launcher.RayLauncher": (
        "ray.init.num_cpus", "ray.init.num_gpus", "ray.remote.num_cpus", "ray.remote.num_gpus",
    ),
}  # fmt: skip
"""Launchers, and what may be set of them: nothing that hands on shell lines, programs or addresses."""
SWEEPERS: dict[str, tuple[str, ...]] = {
    "hydra._internal.core_plugins.basic_sweeper.BasicSweeper": ("max_batch_size", "params"),
    "hydra_plugins.hydra_optuna_sweeper.optuna_sweeper.OptunaSweeper": (
        "params", "sampler", "direction", "study_name", "n_trials", "n_jobs", "max_failure_rate",
    ),
}  # fmt: skip
SAMPLERS = tuple(f"optuna.samplers.{name}Sampler" for name in ("CmaEs", "NSGAII", "Random", "TPE"))
AS_INSTALLED = ("pre_dispatch", "2*n_jobs")
"""An argument that may not be set, and what it comes with."""
INTERPOLATED = ("${hydra.sweep.dir}/.submitit/%j", "${hydra.job.name}")
LOG_FILE = "${hydra.runtime.output_dir}/${hydra.job.name}.log"
LOG_VALUES: dict[str, tuple[str, ...]] = {
    "class": ("logging.StreamHandler", "logging.FileHandler", "logging.NullHandler"),
    "stream": ("ext://sys.stdout", "ext://sys.stderr"),
    "filename": (LOG_FILE,),
}
LOG_SECTIONS = ("formatters", "handlers", "loggers")
LOG_KEYS = (
    *LOG_SECTIONS, *LOG_VALUES, "version", "root", "disable_existing_loggers", "level", "formatter", "format",
    "datefmt", "mode", "delay", "propagate",
)  # fmt: skip
Path = tuple[str, ...]


def check(hydra: DictConfig) -> None:
    """Refuse settings of Hydra that could run, import, read or write what they name.

    Args:
        hydra: The node `hydra` of a composed configuration, before anything was made of it.

    Raises:
        InputError: The first such setting.
    """
    settings: Any = OmegaConf.to_container(hydra, resolve=False)
    for path, value in _leaves(settings):
        rules = [rule for beginning, rule in RULES.items() if path[: len(beginning)] == beginning]
        if not all(rule(path, value) for rule in rules):
            name = ".".join(("hydra", *path))
            raise InputError(f"{name} must be left as it is", got=repr(value), remedy=f"leave {name} out")
    for name, table in {"launcher": LAUNCHERS, "sweeper": SWEEPERS}.items():
        _check_component(f"hydra.{name}", settings[name], table)


def _leaves(node: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Every value with the keys that lead to it; the entries of a list stand under the key of the list."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _leaves(value, (*path, str(key)))
    elif isinstance(node, list):
        for value in node:
            yield from _leaves(value, path)
    else:
        yield path, node


def _check_component(name: str, node: Any, table: dict[str, tuple[str, ...]]) -> None:
    """A component of a table, with no more than the arguments that stand there."""
    target = str(node.get("_target_") if isinstance(node, dict) else node)
    if target not in table:
        raise InputError(f"{name}._target_ must be one of {', '.join(table)}", got=repr(target))
    for path, value in _leaves(node):
        is_known = path[0] in table[target] or ".".join(path) in table[target]
        if path != ("_target_",) and not (_is_plain(path, value) if is_known else _is_untouched(path, value)):
            full = ".".join((name, *path))
            remedy = f"{name} takes {', '.join(table[target]) or 'nothing'}"
            raise InputError(f"{full} must be left as it is", got=repr(value), remedy=remedy)


def _is_untouched(path: Path, value: Any) -> bool:
    return not value or (path[-1], value) == AS_INSTALLED


def _is_plain(path: Path, value: Any) -> bool:
    """A number or one line of text, which names nothing that would be made."""
    if path[-1] == "_target_":
        return path[0] == "sampler" and value in SAMPLERS
    is_text = "\n" not in str(value) and ("${" not in str(value) or value in INTERPOLATED)
    return is_text and not any(key.startswith("_") for key in path)


def _is_callback(path: Path, value: Any) -> bool:
    return value is None or (path[2:] == ("_target_",) and value in CALLBACKS)


def _is_of_a_log(path: Path, value: Any) -> bool:
    keys = path[1:2] + path[3 if path[1:2] and path[1] in LOG_SECTIONS else 2 :]
    if not {*keys} <= {*LOG_KEYS} or ("class" in keys and path[1] != "handlers"):
        return False
    if keys and keys[-1] in LOG_VALUES:
        return value in LOG_VALUES[keys[-1]] and (keys[-1], path[0]) != ("filename", "hydra_logging")
    return "${" not in str(value) and "://" not in str(value)


def _is_name(_: Path, value: Any) -> bool:
    """The name of a file: no way up or to the root, and nothing interpolated but Hydra's own values."""
    return value is None or bool(re.fullmatch(r"(?!\.\.?$)([\w.,=+-]|\$\{hydra[.:]job\.\w+\})+|\?\?\?", str(value)))


RULES: dict[Path, Callable[[Path, Any], bool]] = {
    ("callbacks",): _is_callback,
    ("job_logging",): _is_of_a_log,
    ("hydra_logging",): _is_of_a_log,
    ("searchpath",): lambda *_: False,
    ("output_subdir",): _is_name,
    ("sweep", "subdir"): _is_name,
    ("job", "name"): _is_name,
    ("job", "env_set"): lambda *_: False,
    ("job", "env_copy"): lambda *_: False,
    ("runtime", "output_dir"): lambda _, value: value == "???",
}
"""What the values below these keys must be."""


# 2. Overrides.

OF_SEVERAL_KINDS = ("devices", "fast_dev_run", "log_model")
"""Options that may have values of other types than their default."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


KINDS: dict[type, tuple[str, Callable[[Any], bool]]] = {
    bool: ("true or false", lambda value: isinstance(value, bool)),
    int: ("a number", _is_number),
    float: ("a number", _is_number),
}


class Place(NamedTuple):
    """Value at a key; if the key does not exist, the last mapping on its path, its prefix, and the missing name."""

    value: Any
    above: str = ""
    lost: str | None = None


def check_overrides(base: DictConfig, overrides: Iterable[Override], others: Iterable[str]) -> None:
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
    """Follow a key such as `data.patch` or `scene.surfaces.0.opacity` as far as it exists."""
    node, above = base, ""
    for name in filter(None, key.split(".")):
        if name not in _names(node):
            return Place(node, above, name)
        node, above = _child(node, name), f"{above}{name}."
    return Place(node)


def unknown(key: str, place: Place, others: Iterable[str] = ()) -> InputError:
    """The error for a key that does not exist, with the nearest one that does; `others`: candidates without dots."""
    known = [*_names(place.value), *_arguments(place.value), *(() if place.above else others)]
    lost = RENAMED.get(str(place.lost), str(place.lost))
    near = difflib.get_close_matches(lost, [name for name in known if name[0] != "_"], 1)
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
    """Names that `+` may add: arguments of a component, or any entry of a mapping of components."""
    children = [_child(place.value, name) for name in _names(place.value)]
    is_open = place.above and isinstance(place.value, DictConfig) and "_target_" not in place.value
    if is_open and all(child is None or isinstance(child, DictConfig) for child in children):
        return [str(place.lost)]
    return _arguments(place.value)


def _arguments(node: Any) -> list[str]:
    target = _child(node, "_target_") if "_target_" in _names(node) else None
    return list(inspect.signature(parts.resolve(target)).parameters) if target else []


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


# 3. Hydra's loader with these checks.

WRONG_USAGE = 2


class CheckedLoader(ConfigLoaderImpl):
    """Composes what a configuration may be, or leaves with one line."""

    def load_configuration(self, *args: Any, **kwargs: Any) -> DictConfig:
        """As Hydra's."""
        self._overrides: list[Override] = []
        try:
            config = super().load_configuration(*args, **kwargs)
            check(config.hydra)
        except Exception as error:  # whatever it is, it is about the configuration
            said = error if isinstance(error, LfrefError) else self._explained(error)
            exit_codes.fail(JobRuntime.instance().get("name"), said, WRONG_USAGE)
        return config

    def _process_config_searchpath(self, config_name: str | None, parsed_overrides: list[Override], repo: Any) -> None:
        """As Hydra's, which imports the packages on a search path."""
        self._overrides = parsed_overrides
        for override in parsed_overrides:
            if "searchpath" in override.key_or_group:
                remedy = "give --config-dir FOLDER"
                raise InputError("hydra.searchpath must be left out", got=override.input_line, remedy=remedy)
        super()._process_config_searchpath(config_name, parsed_overrides, repo)

    def _compose_config_from_defaults_list(self, defaults: list[Any], repo: Any) -> DictConfig:
        """As Hydra's, which merges the overrides of single values into it right afterwards."""
        config = super()._compose_config_from_defaults_list(defaults, repo)
        ours = [override for override in self._overrides if not override.is_hydra_override()]
        others = [*SHORTHANDS, *repo.get_group_options("", None)]
        added = [override.get_key_element()[1:] for override in ours if override.is_add()]
        packages = {default.override_key: default.package for default in defaults if default.override_key in added}
        if packages:
            rest = [default for default in defaults if default.override_key not in packages]
            check_groups(super()._compose_config_from_defaults_list(rest, repo), packages, others)
        check_overrides(config, [each for each in ours if not repo.group_exists(each.key_or_group)], others)
        return config

    def _explained(self, error: Exception) -> object:
        """Hydra's message as one line; a choice that does not exist gets those that do."""
        for override in self._overrides:
            group, value = override.key_or_group, override.value()
            known = self.repository.get_group_options(group)
            if known and isinstance(value, str) and value not in known:
                near = difflib.get_close_matches(RENAMED.get(value, value), known, 1)
                remedy = f"perhaps {group}={near[0]}" if near else ""
                return InputError(f"{group} must be one of {', '.join(known)}", got=repr(value), remedy=remedy)
        alien = re.search(r"Could not override '([^']+)'.\s+No match in the defaults list", str(error))
        if alien:
            return unknown(alien[1], Place(None), ())
        return str(error) or error.__cause__


@contextmanager
def checking() -> Iterator[None]:
    """While this lasts, Hydra composes by `CheckedLoader`."""
    before = runner.ConfigLoaderImpl
    runner.ConfigLoaderImpl = CheckedLoader  # type: ignore[misc]
    try:
        yield
    finally:
        runner.ConfigLoaderImpl = before  # type: ignore[misc]
