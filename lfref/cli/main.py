"""The console script: `lfref COMMAND [PATH ...] [KEY=VALUE ...]` composes `conf/COMMAND.yaml` by Hydra and runs it.

Before Hydra reads the line, paths become `input=`, and a few short words become what they stand for. PyTorch is
imported only once the configuration is there.
"""

import gc
import importlib
import os
import sys
from datetime import datetime
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import hydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from omegaconf import DictConfig, OmegaConf

import lfref
from lfref import extras
from lfref.cli.config import directory, plain
from lfref.errors import InputError, LfrefError
from lfref.io import atomic
from lfref.io.run import Run, key_of

COMMANDS = {
    "info": "show properties of light fields, the slopes of their scenes, and their defects",
    "train": "train a network on labels made by an operator",
    "eval": "compare checkpoints and operators plane by plane with the sources of labels",
    "refocus": "refocus light fields into stacks, pictures, films, disparity and point clouds",
    "view": "make a page on which people refocus a light field themselves",
    "export": "write a network or an operator as a file that other runtimes load",
    "bench": "measure accuracy against time of every operator and checkpoint",
    "simulate": "write simulated light fields",
    "report": "gather runs into one page",
    "dashboard": "make a workspace and a report in Weights & Biases",
}
INPUTS = {"report": "runs"} | dict.fromkeys(("info", "refocus", "view", "eval", "bench"), "input")
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
PATHS = "input", "output", "resume", "checkpoint", "truth", "flat_field", "correct"
"""Keys of paths, in which Hydra would interpret some characters."""
TAKE_A_WORD = "--cfg", "-c", "--config-dir", "-cd", "--config-path", "-cp", "--config-name", "-cn", "--package", "-p"


def main() -> None:
    """Run a command; status 0 if it worked, 1 if it failed, 2 if it does not exist."""
    if "OMP_WAIT_POLICY" not in os.environ:  # OpenMP reads it when PyTorch is imported
        os.environ.setdefault("GOMP_SPINCOUNT", "1000")  # a waiting thread must not take the core of another one
    name, words = sys.argv[1] if len(sys.argv) > 1 else "--help", sys.argv[2:]
    if name in ("-h", "--help", "-V", "--version"):
        print(f"lfref {lfref.__version__}" if name in ("-V", "--version") else usage())
        return
    if name not in COMMANDS:
        fail("COMMAND", InputError(f"command must be one of {', '.join(COMMANDS)}", got=repr(name)), status=2)
    try:
        words = rewritten(name, words)
    except LfrefError as error:
        fail(name, error, status=2)
    start(name, words)


def start(name: str, words: list[str]) -> None:
    """Let Hydra compose the configuration of a command, and run it, once for each job of a multirun."""
    # Lightning starts the other processes of a ddp run as `python ARGV[0] ...`: that is the module of the command.
    sys.argv = [str(Path(__file__).with_name(f"{name}.py")), *words]
    if not any(word.startswith("hydra.job.name=") for word in words):
        sys.argv.append(f"hydra.job.name={name}")
    if not any(key_of(word) == "output" for word in words):
        sys.argv.append(f"output=runs/{name}/{datetime.now():%Y-%m-%d_%H-%M-%S}")

    def task(config: DictConfig) -> float | None:
        try:
            check_input(plain(config).get(INPUTS.get(name)))
            with extras.needed("this command"):
                run = imported(name).run
        except LfrefError as error:
            fail(name, error)
        result: float | None = run(config)
        return result

    try:
        hydra.main(version_base="1.3", config_path=str(directory()), config_name=name)(task)()
    except KeyboardInterrupt:
        sys.exit(130)


def check_input(value: str | list[str] | None) -> None:
    """Refuse paths that do not exist before PyTorch is imported, which takes a second."""
    for path in [value] if isinstance(value, str) else value or []:
        with atomic.file_errors(Path(path), "read"):
            Path(path).stat()


def fail(name: str, error: object, status: int = 1) -> NoReturn:
    """Print the error of a command in one line and exit; status 1: the command failed, 2: wrong usage."""
    print(f"lfref {name}: {' '.join(str(error).split())}", file=sys.stderr)
    sys.exit(status)


def imported(name: str) -> ModuleType:
    """The module of a command; the garbage collector would take a fifth of the time of its imports."""
    if "torch" not in sys.modules:
        gc.disable()
        importlib.import_module("torch")
        gc.freeze()  # before OpenImageIO is imported, which reports objects that are left at the end
        gc.enable()
    return importlib.import_module(f"lfref.cli.{name}")


def rewritten(command: str, words: list[str]) -> list[str]:
    """Words for Hydra: paths as `input=`, short words as what they stand for."""
    is_multirun = bool({"-m", "--multirun"} & set(words))
    end = words.index("--") if "--" in words else len(words)
    paths, options, others = [], [], []  # Hydra takes options before all overrides
    for word, before in zip(words[:end], ["", *words], strict=False):
        key, equals, value = word.partition("=")
        if before in TAKE_A_WORD or word.startswith("-"):
            options.append(word)
        elif word.startswith(("/", "./", "../", "~/")) or not (equals or word.startswith("~")):
            paths.append(word)
        elif key == "run" and command in RUN:
            others.append(f"{RUN[command]}={_readable(value, is_multirun)}")
        elif key == "+sweep":
            others += overrides(value)
        elif key in SHORTHANDS:
            value = value if is_multirun or value.startswith("[") else f"[{value}]" if key != "convention" else value
            others += [form.replace("{}", value) for form in SHORTHANDS[key]]
        else:
            others.append(f"{key}={_readable(value, is_multirun)}" if key in PATHS else word)
    paths += words[end + 1 :]
    if paths and command not in INPUTS:
        raise InputError("arguments of this command must be written KEY=VALUE", got=repr(paths[0]))
    if {"method", "checkpoint"} <= {key_of(word) for word in others}:
        raise InputError("a method or a network refocuses", got="method= and run=", remedy="leave one of them out")
    # The light field that ships with lfref.
    paths = [str(directory("sample")) if path == "sample" and not Path(path).exists() else path for path in paths]
    values = [_quoted(path) for path in paths]
    own = values[0] if len(values) == 1 else f"[{','.join(values)}]"
    return [*options, *resumed([*others, f"{INPUTS[command]}={own}"] if paths else others)]


def resumed(words: list[str]) -> list[str]:
    """The words with `resume=RUN` preceded by the overrides of that run and its folder, unless they are given anew.

    `resume=auto` goes on with the run in `output`, if there is one.
    """
    parser, own = OverridesParser.create(), [word for word in words if key_of(word) in ("resume", "output")]
    given = {key_of(word): parser.parse_override(word).value() for word in own}
    if (path := given.get("resume")) is None:
        return words
    words = [word for word in words if key_of(word) != "resume"]
    if path == "auto":
        if (path := given.get("output")) is None:
            raise InputError("resume=auto goes on in output", got="none", remedy="add output=RUN")
        if not Run(Path(str(path))).has_begun:
            return words
    run = Run.of(str(path))
    output = [f"output={_quoted(str(run.folder))}", *words]
    new = {key_of(word) for word in output} | {"folder", "resume", "overwrite"}
    return [*(word for word in run.overrides if key_of(word) not in new), *output, f"resume={_quoted(str(path))}"]


def _readable(path: str, is_multirun: bool) -> str:
    """A path as Hydra reads it: lists, `null` and what is quoted already stay, and all choices of a multirun."""
    if is_multirun or path == "null" or path[:1] in ("[", "'", '"'):
        return path
    return _quoted(os.path.expanduser(path))  # noqa: PTH111  not every shell expands it behind `=`


def _quoted(path: str) -> str:
    return str(QuotedString(path.replace("${", "\\${"), Quote.single).with_quotes())


def overrides(name: str) -> list[str]:
    """Overrides `key=a,b,c` of the sweep `sweeps/NAME.yaml`, which is also a sweep of wandb; InputError for others."""
    files = {path.stem: path for path in sorted(directory("sweeps").glob("*.yaml"))}
    if name not in files:
        raise InputError(f"sweep must be one of {', '.join(files)}", got=repr(name))
    parameters = OmegaConf.load(files[name]).parameters
    if not all("values" in entry for entry in parameters.values()):
        raise InputError("a sweep of Hydra must list its values", got=name, remedy=f"wandb sweep sweeps/{name}.yaml")
    return [f"{key}={','.join(map(str, entry['values']))}" for key, entry in parameters.items()]


def usage() -> str:
    """The text of `lfref --help`."""
    commands = "\n".join(f"  {name:<9} {what}" for name, what in COMMANDS.items())
    return f"""Light-field refocusing, classical and learned.

lfref COMMAND [PATH ...] [KEY=VALUE ...]

{commands}

lfref COMMAND --help shows choices and the configuration; --multirun runs KEY=A,B,C in turn."""


if __name__ == "__main__":
    main()
