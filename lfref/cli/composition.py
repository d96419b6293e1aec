"""Checks of a composed configuration, before PyTorch is imported, and before Hydra or a command acts on it.

1. `hydra.*` must agree with tables (`check`): Hydra builds callbacks, launchers, sweepers and log handlers from it,
   some before a command starts.
2. Overrides must fit what they override (`check_overrides`): every key exists, flags are flags, numbers are numbers.
   Hydra itself would suggest `+key` for a misspelt key, and takes any text for true.
3. `check_line` composes a command line before `hydra.main` gets it, and `CheckedJobs` does so for each job of a sweep.

Three parts rely on undocumented behaviour of Hydra. `CheckedJobs` replaces the attribute `config_loader` of the running
application, since Hydra calls nothing of ours between the composition of a job and its log handlers. `COMPONENTS` names
the classes of the launcher and the sweeper that come with Hydra.
This module stands apart from `command`, which wraps a command: these checks keep configurations harmless.
"""

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hydra import initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from lfref.cli import arguments, exit_codes, parts
from lfref.cli import config as configs
from lfref.errors import InputError, LfrefError
from lfref.io import atomic
from lfref.io.options import ReadOptions

RENAMED = {
    "guides": "features", "n_guides": "n_features", "n_offers": "n_candidates",
    "fourier_slice_wide": "fourier_slice", "fourier_slice_linear_padded": "fourier_slice",
    "judged": "test_scenes",
}  # fmt: skip
"""Keys and choices of earlier versions -> today's, which the error about an unknown one names."""

# 1. Settings of Hydra itself. Values are checked as written: an interpolation could become anything later.

CALLBACKS = {
    "output_folder": {"_target_": "lfref.cli.run_folder.OutputFolder"},
    "checked_jobs": {"_target_": "lfref.cli.composition.CheckedJobs"},
    "failed_jobs": {"_target_": "lfref.cli.resume.FailedJobs"},
}
"""All of these, and no others, must stand in a configuration."""
COMPONENTS = {
    "launcher": (
        "hydra._internal.core_plugins.basic_launcher.BasicLauncher",
        "hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher",
        "hydra_plugins.hydra_submitit_launcher.submitit_launcher.LocalLauncher",
        "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher",
        "hydra_plugins.hydra_ray_launcher.ray_launcher.RayLauncher",
    ),
    "sweeper": (
        "hydra._internal.core_plugins.basic_sweeper.BasicSweeper",
        "hydra_plugins.hydra_optuna_sweeper.optuna_sweeper.OptunaSweeper",
    ),
}
SAMPLERS = tuple(f"optuna.samplers.{name}Sampler" for name in ("CmaEs", "NSGAII", "Random", "TPE"))
TEXTS = (
    "params", "direction", "study_name", "prefer", "require", "batch_size", "max_nbytes", "mmap_mode",
    "submitit_folder", "name", "partition", "qos", "comment", "constraint", "exclude", "gres", "mem_per_gpu",
    "mem_per_cpu", "account",
)  # fmt: skip
"""Arguments of launchers and sweepers that may be text: none is run or opened, and none is an address."""
DEFAULTS = ("2*n_jobs", "${hydra.sweep.dir}/.submitit/%j", "${hydra.job.name}")
"""Default values of launchers, which are allowed although they are neither plain text nor numbers."""
LOG_FILE = "${hydra.runtime.output_dir}/${hydra.job.name}.log"
LOG_VALUES: dict[str, tuple[str, ...]] = {
    "class": ("logging.StreamHandler", "logging.FileHandler", "logging.NullHandler"),
    "stream": ("ext://sys.stdout", "ext://sys.stderr"),
    "filename": (LOG_FILE,),
}
LOG_KEYS = (
    *LOG_VALUES, "handlers", "version", "disable_existing_loggers", "level", "formatter", "format", "datefmt", "mode",
    "delay", "propagate", "loggers",
)  # fmt: skip
Keys = tuple[str, ...]


def check(hydra: DictConfig) -> None:
    """Refuse settings (the node `hydra` of a configuration) that could run, import, read or write something else."""
    settings: Any = OmegaConf.to_container(hydra, resolve=False)
    if settings["callbacks"] != CALLBACKS:
        raise InputError("hydra.callbacks must be left as it is", got=repr(settings["callbacks"]))
    for name, known in COMPONENTS.items():
        target = settings[name].get("_target_") if isinstance(settings[name], dict) else settings[name]
        if target not in known:
            raise InputError(f"hydra.{name}._target_ must be one of {', '.join(known)}", got=repr(target))
    for path, value in _leaves(settings):
        rules = [rule for beginning, rule in RULES.items() if path[: len(beginning)] == beginning]
        if not all(rule(path, value) for rule in rules):
            name = ".".join(("hydra", *path))
            raise InputError(f"{name} must be left as it is", got=repr(value), remedy=f"leave {name} out")


def _leaves(node: Any, path: Keys = ()) -> Iterator[tuple[Keys, Any]]:
    """Every value with its keys; the entries of a list stand under the key of the list."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _leaves(value, (*path, str(key)))
    elif isinstance(node, list):
        for value in node:
            yield from _leaves(value, path)
    else:
        yield path, node


def _is_plain(path: Keys, value: Any) -> bool:
    """Whether a launcher or sweeper may have this value: a number, or one line of text that names nothing to build."""
    if path[-1] == "_target_":
        return len(path) == 2 or (path[1:-1] == ("sampler",) and value in SAMPLERS)
    if any(key.startswith("_") for key in path):
        return False
    is_text = path[1] in TEXTS and "\n" not in str(value) and "${" not in str(value)
    return is_text or value in DEFAULTS or not value or isinstance(value, int | float)


def _is_of_a_log(path: Keys, value: Any) -> bool:
    key = path[-1]
    if value is None:
        return True
    if len(path) == 1 or key not in LOG_KEYS or len(path) > 4 or (key == "class" and path[1] != "handlers"):
        return False
    if key in LOG_VALUES:
        return value in LOG_VALUES[key] and (key, path[0]) != ("filename", "hydra_logging")
    return "${" not in str(value) and "://" not in str(value)


def _is_name(_: Keys, value: Any) -> bool:
    """Whether a value is the name of a file without folders that interpolates only Hydra's own values."""
    return value is None or bool(re.fullmatch(r"(?!\.\.?$)([\w.,=+-]|\$\{hydra[.:]job\.\w+\})+|\?\?\?", str(value)))


RULES: dict[Keys, Callable[[Keys, Any], bool]] = {
    **dict.fromkeys([("launcher",), ("sweeper",)], _is_plain),
    **dict.fromkeys([("job_logging",), ("hydra_logging",)], _is_of_a_log),
    **dict.fromkeys([("output_subdir",), ("sweep", "subdir"), ("job", "name")], _is_name),
    **dict.fromkeys([("searchpath",), ("job", "env_set"), ("job", "env_copy")], lambda *_: False),
    ("runtime", "output_dir"): lambda _, value: value == "???",
}
"""Beginning of a key -> condition of all values below it."""


# 2. Overrides.

OF_SEVERAL_KINDS = ("devices", "fast_dev_run", "log_model")
"""Options that may have values of other types than their default."""


def check_overrides(base: DictConfig, overrides: Iterable[Override], others: Iterable[str]) -> None:
    """Refuse overrides of keys that `base` does not have, and values of another type.

    `others` are further names that a misspelt key without dots may stand for.
    """
    for override in overrides:
        key = override.key_or_group
        default = find(base, key, key, others, override.is_add() or override.is_force_add())
        if override.is_delete() or override.is_sweep_override() or key.split(".")[-1] in OF_SEVERAL_KINDS:
            continue
        value = override.value()
        is_flag, is_number = isinstance(value, bool), isinstance(value, int | float)
        if value is None or "${" in str(value) or not isinstance(default, int | float):
            continue
        if isinstance(default, bool) and not is_flag:
            raise InputError(f"{key} must be true or false", got=repr(value))
        if not isinstance(default, bool) and (is_flag or not is_number):
            raise InputError(f"{key} must be a number", got=repr(value))


def find(base: DictConfig, path: str, key: str, others: Iterable[str], may_add: bool) -> Any:
    """The value at a path such as `scene.surfaces.0.opacity`; None if it does not exist, but may be added.

    Args:
        base: A configuration.
        path: Keys and indices.
        key: The word on the command line that stands for this path.
        others: Further names that a misspelt key without dots may stand for.
        may_add: Whether arguments of a part, and entries of a mapping of parts, may be added.

    Raises:
        InputError: The path does not exist; the message names the nearest key that does.
    """
    node: Any = base
    above = ""
    for name in filter(None, path.split(".")):
        children = _children(node)
        if name not in children:
            target = children.get("_target_")
            options = parts.argument_names(target) if target else []
            is_open = above and isinstance(node, DictConfig) and "_target_" not in children
            is_open = is_open and all(child is None or isinstance(child, DictConfig) for child in children.values())
            if may_add and (name in options or is_open):
                return None
            if name in options:
                remedy = f"add +{above}{name}=VALUE"
                raise InputError(
                    "a key that the configuration does not set must be added", got=repr(key), remedy=remedy
                )
            known = [*children, *options, *(() if above else others)]
            near = _nearest(name, [other for other in known if other[0] != "_"])
            remedy = f"perhaps {above}{near}" if near else "--cfg job shows all"
            if near == name:  # options of the command line, which no configuration holds
                remedy = f"write it without +: {name}=VALUE"
            raise InputError("every key must be one of this command", got=repr(key), remedy=remedy)
        node, above = children[name], f"{above}{name}."
    return node


def _children(node: Any) -> dict[str, Any]:
    """Values of a mapping or list by name; None for values that are missing, or not resolvable yet."""
    children: dict[str, Any] = {}
    names = range(len(node)) if isinstance(node, ListConfig) else node if isinstance(node, DictConfig) else ()
    for name in names:
        try:
            children[str(name)] = node[name]
        except OmegaConfBaseException:
            children[str(name)] = None
    return children


def _nearest(name: str, known: Iterable[str]) -> str | None:
    return next(iter(difflib.get_close_matches(RENAMED.get(name, name), known, 1)), None)


# 3. Composition.


_checked: list[tuple[str, ...]] = []
"""The command line that `check_early` has checked; the command does not compose it once more."""


def check_early(command: str, words: list[str]) -> None:
    """Check a command line before the command's module is imported, and with it PyTorch, which takes seconds."""
    _checked[:] = [(command, *check_line(command, words))]


def check_line(command: str, words: list[str]) -> list[str]:
    """Compose and check a command line; returns its words, options first, or exits with one line."""
    if _checked and _checked.pop() == (command, *words):
        return words
    options = arguments.options(command, words)
    folder, shows = options["config_dir"], any(options[name] for name in ("help", "hydra_help", "cfg", "info"))
    if folder is not None and not Path(folder).is_dir():
        raise InputError("--config-dir must be a folder", got=folder)
    mode = RunMode.MULTIRUN if options["multirun"] and not shows else RunMode.RUN
    if not options["shell_completion"]:
        with initialize_config_dir(str(configs.directory()), command, "1.3"):
            loader = GlobalHydra.instance().config_loader()
            config = check_composition(loader, command, options["overrides"], mode, folder)
        if mode == RunMode.RUN and not shows:
            check_files(config)
    return [*arguments.as_words(options), *options["overrides"]]


class CheckedJobs(Callback):
    """Composes and checks each job of a sweep before it starts, with any launcher and in any process."""

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Replace the loader that Hydra is about to hand to the sweeper and its launcher."""
        try:
            application: Any = GlobalHydra.instance().hydra
            application.config_loader = CheckedLoader(application.config_loader)
        except Exception as error:  # Hydra would only warn
            exit_codes.fail(config.hydra.job.config_name, error)


class CheckedLoader:
    """The part of Hydra's `ConfigLoader` that sweepers and launchers use."""

    def __init__(self, loader: ConfigLoader) -> None:
        self.loader = loader

    def load_sweep_config(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        """The configuration of a job."""
        hydra = master_config.hydra
        check_composition(self.loader, hydra.job.config_name, [*hydra.overrides.hydra, *sweep_overrides], RunMode.RUN)
        return self.loader.load_sweep_config(master_config, sweep_overrides)

    def get_group_options(self, *args: Any, **kwargs: Any) -> list[str]:
        """The files of a group."""
        return self.loader.get_group_options(*args, **kwargs)


def check_composition(
    loader: ConfigLoader, command: str, words: Sequence[str], mode: RunMode, folder: str | None = None
) -> DictConfig:
    """Compose a configuration and check it; exits with one line if it is refused.

    Args:
        loader: Hydra's loader.
        command: The command's name.
        words: Overrides.
        mode: Whether overrides may be those of a sweep.
        folder: Further choices, from `--config-dir`; Hydra looks for files there last.
    """
    quoted = QuotedString(f"file://{Path(folder or '').absolute()}", Quote.single).with_quotes()
    search = [] if folder is None else [f"hydra.searchpath=[{quoted}]"]
    overrides: list[Override] = []
    try:
        overrides = arguments.parsed(words)
        for override in overrides:  # before Hydra imports packages that stand in a search path
            if "searchpath" in override.key_or_group:
                remedy = "give --config-dir FOLDER"
                raise InputError("hydra.searchpath must be left out", got=override.input_line, remedy=remedy)
            if override.key_or_group == "output" and override.value() in (None, ""):
                expected, remedy = "output must name a folder", "leave it out for a new folder"
                raise InputError(expected, got=override.value() or "nothing", remedy=remedy)
        groups = [item for item in overrides if loader.get_group_options(item.key_or_group, overrides=search)]
        values = [item for item in overrides if item not in groups and not item.is_hydra_override()]
        added = [item for item in groups if item.is_add() and not item.is_hydra_override()]
        others = [*arguments.SHORTHANDS, *loader.list_groups("")]

        def compose(left_out: list[Override]) -> DictConfig:
            kept = [str(override.input_line) for override in overrides if override not in left_out]
            return loader.load_configuration(command, [*search, *kept], mode)

        base = compose(values)
        rest = compose([*values, *added]) if added else base
        for override in added:  # files added by +GROUP=NAME to a place that no command reads
            place = override.package or override.key_or_group.replace("/", ".")
            if OmegaConf.select(base, place) is not None:  # a file may name another place itself
                find(rest, place, override.get_key_element()[1:], others, may_add=True)
        check_overrides(base, values, others)
        whole = compose([])
        if search:
            whole.hydra.searchpath = []
        check(whole.hydra)
        return whole
    except Exception as error:  # whatever it is, it is about the configuration
        exit_codes.fail(command, _explanation(loader, overrides, error, search), status=2)


FILES = (
    "input", "runs", "checkpoint", "white", "truth", "correct", "splits", "data.path", "data.validation_path",
)  # fmt: skip
"""Keys of configurations that name the user's files."""
CORRECT = ("auto", "none", "white")
"""Values of `correct` that name no file."""


def check_files(config: DictConfig) -> None:
    """Refuse a configuration whose input is not given, or that names files that do not exist.

    Raises:
        InputError: An input is missing, or `correct` is no choice.
        FileError: A file or folder does not exist.
    """
    if "reader" in config:
        ReadOptions.parse(**configs.plain(config.reader))
    for key in FILES:
        value = OmegaConf.select(config, key, throw_on_missing=False)
        if OmegaConf.is_missing(config, key):
            raise InputError(f"{key} must be given", got="none", remedy=f"add PATH, or {key}=PATH")
        for path in [value] if isinstance(value, str | bool) else value or ():
            place = Path(str(path))
            if key == "correct" and path in CORRECT:
                continue
            if key == "correct" and not place.exists():
                expected = "correct must be auto, none, or a file that correct=auto wrote"
                raise InputError(expected, got=f"no corrections at {path}", remedy="correct=none corrects nothing")
            if pattern_folder(place) is None:
                with atomic.file_errors(place, "read"):
                    place.stat()


def pattern_folder(path: Path) -> Path | None:
    """The longest folder of a pattern such as `shots/*.exr` that exists; None if a path is no pattern.

    Folders that exist may have brackets or stars in their own names: only what follows them is a pattern.
    """
    if arguments.exists(path) or not set("*?[") & set(str(path)):
        return None
    return next(parent for parent in path.absolute().parents if arguments.exists(parent))


def _explanation(loader: ConfigLoader, overrides: list[Override], error: Exception, search: list[str]) -> object:
    """Hydra's message as one line; for a choice that does not exist, the choices."""
    if isinstance(error, LfrefError):
        return error
    for override in overrides:
        group, value = override.key_or_group, override.value()
        known = loader.get_group_options(group, overrides=search)
        if known and isinstance(value, str) and value not in known:
            near = _nearest(value, known)
            remedy = f"perhaps {group}={near}" if near else "choices of your own need --config-dir FOLDER"
            return InputError(f"{group} must be one of {', '.join(known)}", got=repr(value), remedy=remedy)
    ambiguous = re.search(r"Ambiguous value for argument '([^=']+)=([^']+)'", str(error))
    if ambiguous:
        key, value = ambiguous.groups()
        remedy = f"write {key}=[{value}], or add --multirun to run one after the other"
        return InputError(f"{key} must be one value", got=repr(value), remedy=remedy)
    places = re.search(r"Could not override '([^']+)'\.\s+Did you mean to override (?:one of )?([^?]+)\?", str(error))
    if places:
        value = next((override.value() for override in overrides if override.key_or_group == places[1]), "NAME")
        lines = " or ".join(f"{place}={value}" for place in places[2].split(", "))
        return InputError("a choice must name its place", got=f"{places[1]}={value}", remedy=f"write {lines}")
    alien = re.search(r"Could not override '([^']+)'.\s+No match in the defaults list", str(error))
    if alien:
        return InputError("every key must be one of this command", got=repr(alien[1]), remedy="--cfg job shows all")
    unfit = re.search(r"Error merging override ([^=\s]+)=(.*)", str(error))
    if unfit:
        expected, remedy = f"{unfit[1]} must have a value of its kind", "--cfg job shows what it holds"
        return InputError(expected, got=repr(unfit[2].strip()), remedy=remedy)
    return str(error) or error.__cause__
