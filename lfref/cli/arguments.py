"""The command line as people write it, turned into the words that Hydra reads.

Paths may contain any characters; `slopes=`, `alphas=` and `convention=` choose planes; `run=` stands for the key that
takes a run folder; `+sweep=NAME` names a file of ablations. Habits of other programs are understood: `-o FOLDER`,
`--method learned`, `--slopes 1 2`, `slopes=1,2`.
"""

import argparse
import os
import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from lfref.cli import config, exit_codes
from lfref.cli import help as texts
from lfref.errors import InputError

# Ablations are one file for two runners: `sweeps/NAME.yaml` is a wandb sweep, and `lfref train --multirun +sweep=NAME`
# becomes one override per parameter, `key=a,b,c`, before Hydra reads the line.


def overrides(name: str, folder: Path) -> list[str]:
    """Hydra overrides `key=a,b,c` of the sweep `folder/name.yaml`.

    Raises:
        InputError: There is no such sweep, or its file is no sweep.
    """
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise InputError(f"sweep must be one of {', '.join(known)}", got=repr(name))
    try:
        parameters: Any = OmegaConf.to_container(OmegaConf.load(folder / f"{name}.yaml"))
        return [f"{key}={','.join(map(str, entry['values']))}" for key, entry in parameters["parameters"].items()]
    except (KeyError, TypeError, AttributeError, YAMLError, OmegaConfBaseException) as error:
        raise InputError(f"sweep {name} must hold parameters with a list of values each", got=error) from error


INPUTS = {"report": "runs"} | dict.fromkeys(("info", "refocus", "view", "eval", "bench", "prepare"), "input")
"""Command -> key whose value is a path on the command line."""
RUN = {
    "train": "resume",
    "report": "runs",
    **dict.fromkeys(("refocus", "view", "eval", "bench", "export"), "checkpoint"),
}
"""Command -> key that `run=FOLDER` sets."""
SHORTHANDS = {
    "slopes": ["planes=slopes", "planes.slopes={}"],
    "alphas": ["planes=alphas", "planes.alphas={}"],
    "convention": ["planes.convention={}"],
}
LISTS = "slopes", "alphas"
"""Shorthands for lists of numbers, whose brackets may be left out."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?")
BRACE = "\\${"
"""What stands for `${` in a value, so that nothing is interpolated."""
BEGINNINGS = ("/", "./", "../", "~/")
TEXTS = "input", "output", "resume", "run", "checkpoint", "truth", "white", "correct", "title"
"""Keys whose values are paths or text: what Hydra cannot read of them is quoted."""
REFUSED = (["--config-path", "-cp"], ["--config-name", "-cn"], ["--experimental-rerun"])
"""Options of Hydra that replace our configuration; the last one unpickles a file."""
HYDRA = (
    "--cfg", "--info", "--run", "--multirun", "--shell-completion", "--help", "--hydra-help", "--resolve", "--package",
    "--config-dir", *(names[0] for names in REFUSED),
)  # fmt: skip
"""Options that are Hydra's own, also where they are abbreviated."""


def rewritten(command: str, words: list[str]) -> list[str]:
    """Words for Hydra, options first; after `--` there are paths only.

    Raises:
        InputError: The command takes no paths, the sweep is unknown, or a sweep lacks --multirun.
    """
    end = words.index("--") if "--" in words else len(words)
    parsed = options(command, _as_overrides(command, words[:end]))
    paths = [] if parsed["shell_completion"] else [word for word in parsed["overrides"] if _is_path(word)]
    if len(given := [key for key in LISTS if any(word.startswith(f"{key}=") for word in parsed["overrides"])]) > 1:
        raise InputError("planes must be given once", got=" and ".join(given), remedy="leave one of them out")
    keys = (*texts.defaults(command), *SHORTHANDS)
    if behind := next((word for word in words[end + 1 :] if word.partition("=")[0] in keys and not exists(word)), None):
        raise InputError("only paths may stand behind --", got=repr(behind), remedy="write options before it")
    overrides: list[str] = []
    for word in parsed["overrides"]:
        word = _readable(word, parsed["multirun"])
        overrides += [] if word in paths else _expanded(command, word, overrides, parsed["multirun"])
    return [*as_words(parsed), *_inputs(command, [*paths, *words[end + 1 :]]), *overrides]


def _as_overrides(command: str, words: list[str]) -> list[str]:
    """Words in which `-o X`, `--method learned`, `--slopes 1 2` are written `KEY=VALUE`; Hydra's options stay."""
    defaults = texts.defaults(command)
    translated, queue = [], list(words)
    while queue:
        word = queue.pop(0)
        name, equals, value = word.partition("=")
        key = "output" if name == "-o" else name.removeprefix("--").replace("-", "_")
        is_ours = key in (*defaults, *SHORTHANDS) or not any(option.startswith(name) for option in HYDRA)
        if not (name == "-o" or name.startswith("--")) or not is_ours:
            translated.append(word)
            continue
        if not equals:
            n_numbers = next((n for n, text in enumerate(queue) if not NUMBER.fullmatch(text)), len(queue))
            is_flag = defaults.get(key) in ("true", "false") and queue[:1] not in (["true"], ["false"])
            if not is_flag and not queue:
                raise InputError(f"{name} takes a value", got="none", remedy=f"write {key}=VALUE")
            taken = 0 if is_flag else max(1, n_numbers) if key in LISTS else 1
            value = "true" if is_flag else ",".join(queue[:taken])
            del queue[:taken]
        translated.append(f"{key}={value}")
    return translated


def options(command: str, words: list[str]) -> dict[str, Any]:
    """The options of Hydra among some words, by name, and under `overrides` all other words.

    Raises:
        InputError: One of the options `REFUSED` is given.
    """
    parser = argparse.ArgumentParser(add_help=False)
    setattr(parser, "error", partial(exit_codes.fail, command, status=2))  # noqa: B010
    actions = parser.add_mutually_exclusive_group()
    actions.add_argument("--cfg", "-c", choices=("job", "hydra", "all"))
    infos = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
    actions.add_argument("--info", "-i", nargs="?", const="all", choices=infos)
    for names in (["--run", "-r"], ["--multirun", "-m"], ["--shell-completion", "-sc"]):
        actions.add_argument(*names, action="store_true")
    for names in (["--help", "-h"], ["--hydra-help"], ["--resolve"]):
        parser.add_argument(*names, action="store_true")
    for names in (["--package", "-p"], ["--config-dir", "-cd"], *REFUSED):
        parser.add_argument(*names)
    parser.add_argument("overrides", nargs="*")
    parsed = vars(parser.parse_intermixed_args(words))
    for option, *_ in REFUSED:
        value = parsed.pop(option[2:].replace("-", "_"))
        if value is not None:
            raise InputError(f"{option} must be left out", got=value, remedy="--config-dir adds to our choices")
    return parsed


def as_words(options: dict[str, Any]) -> list[str]:
    """Options as words of a command line; those that are off, and the overrides, are left out."""
    active = {f"--{name.replace('_', '-')}": options[name] for name in options if name != "overrides" and options[name]}
    return [part for option, value in active.items() for part in ([option] if value is True else [option, value])]


def parsed(words: Iterable[str]) -> list[Override]:
    """Overrides as Hydra reads them.

    Raises:
        InputError: It cannot read one of them.
    """
    parser, overrides = OverridesParser.create(), []
    for word in words:
        try:
            overrides.append(parser.parse_override(word))
        except HydraException as error:
            key, _, value = word.partition("=")
            remedy = f"""put the value in quotes, and the word in others: '{key}="{value}"'"""
            raise InputError(f"{key} must have a value that Hydra can read", got=value, remedy=remedy) from error
    return overrides


def _readable(word: str, is_multirun: bool) -> str:
    """An override whose value is a path or text, quoted if Hydra cannot read it or takes it for several values."""
    key, _, value = word.partition("=")
    if key not in TEXTS:
        return word
    if value.startswith("~/"):  # not every shell expands it there
        return _readable(f"{key}={os.path.expanduser(value)}", is_multirun)  # noqa: PTH111
    try:
        override = OverridesParser.create().parse_override(word)
        if is_multirun or not override.is_sweep_override():
            return word
    except HydraException:
        pass
    return f"{key}={QuotedString(value.replace('${', BRACE), Quote.single).with_quotes()}"


def exists(path: str | Path) -> bool:
    """Whether a path exists. `Path.exists` raises where a word is too long for a name."""
    return os.path.exists(path)  # noqa: PTH110


def _is_path(word: str) -> bool:
    return word.startswith(BEGINNINGS) or ("=" not in word and word[:1] != "~") or exists(word)


def _inputs(command: str, paths: list[str]) -> list[str]:
    """Paths as an override, quoted so that Hydra interprets none of their characters."""
    if paths and command not in INPUTS:
        raise InputError("arguments of this command must be written KEY=VALUE", got=repr(paths[0]))
    quoted = [QuotedString(path.replace("${", BRACE), Quote.single).with_quotes() for path in paths]
    value = quoted[0] if len(quoted) == 1 else f"[{','.join(quoted)}]"
    return [f"{INPUTS[command]}={value}"] if paths else []


def _expanded(command: str, word: str, before: list[str], is_multirun: bool) -> list[str]:
    """Replace a shorthand (`run=`, `slopes=`, `sweep=`) by the overrides that it stands for."""
    key, _, value = word.partition("=")
    if key == "run" and command in RUN:
        return [f"{RUN[command]}={value}"]
    if key.removeprefix("+") == "sweep":
        if not is_multirun:
            raise InputError("a sweep needs --multirun", got=word, remedy="lfref train --multirun +sweep=NAME")
        return overrides(value, config.directory("sweeps"))
    if key in LISTS and not is_multirun and re.fullmatch(r"[^\[\]{}$'\"]+", value):
        value = f"[{value}]"
    return [full for form in SHORTHANDS.get(key, [word]) if (full := form.replace("{}", value)) not in before]
