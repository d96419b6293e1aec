"""What a configuration may tell Hydra itself: enough to launch and sweep, nothing that runs or opens what it names.

Hydra makes callbacks, launchers, sweepers and log handlers of whatever `hydra.*` says, some of them before a command
starts. Here that node is held to tables, as it is written: an interpolation could turn into anything later.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any

from omegaconf import DictConfig, OmegaConf

from lfref.errors import InputError

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
        _check_made(f"hydra.{name}", settings[name], table)


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


def _check_made(name: str, node: Any, table: dict[str, tuple[str, ...]]) -> None:
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
