"""The console script: `lfref COMMAND [PATH ...] [KEY=VALUE ...]` calls `main` of the module of that command."""

import difflib
import gc
import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import lfref
from lfref import extensions, extras
from lfref.cli import arguments, composition, threads
from lfref.cli import help as texts
from lfref.cli.exit_codes import exit_line_on_signals, fail, patient_pipes
from lfref.errors import FileError, InputError, LfrefError

COMMANDS = {
    "info": "show properties of light fields, the slopes of their scenes, and their defects",
    "train": "train a network on labels made by an operator",
    "eval": "compare checkpoints and operators plane by plane with the sources of labels",
    "refocus": "refocus light fields into stacks, pictures, films, disparity and point clouds",
    "view": "make a page on which people refocus a light field themselves",
    "export": "write a network or an operator as a file that other runtimes load",
    "bench": "measure accuracy against time of every operator and checkpoint",
    "prepare": "make a set of planes for training",
    "simulate": "write simulated light fields",
    "report": "gather runs into one page",
    "dashboard": "make a workspace and a report in Weights & Biases",
}


def main() -> None:
    """Run a command; status 0 if it worked, 1 if it failed, 2 if it does not exist."""
    threads.set_up()
    try:
        sys.argv[1:], packages = allowed_packages(sys.argv[1:])
        for package in packages:
            extensions.allow(package)
    except InputError as error:
        fail(next(iter(sys.argv[1:]), "--allow"), error, status=2)
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in TEXTS:
        with patient_pipes():
            print(TEXTS[name]())
        return
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, 1) or ["--help"]
        print(
            f"lfref: command must be one of {', '.join(COMMANDS)}; got {name!r}; try lfref {near[0]}", file=sys.stderr
        )
        sys.exit(2)
    try:
        words = arguments.rewritten(name, sys.argv[2:])
        parsed = arguments.options(name, words)
        # `resume=RUN` stands for the overrides of that run, which the command reads itself.
        if words != ["--help"] and not any(word.startswith("resume=") for word in words):
            composition.check_early(name, words)
        if parsed["help"]:
            with patient_pipes():
                print(texts.command_help(name, parsed["overrides"]))
            return
    except LfrefError as error:
        fail(name, error, status=1 if isinstance(error, FileError) else 2)
    with exit_line_on_signals(name):
        try:
            with starting(name), without_collection(), extras.needed("this command"):
                module = importlib.import_module(f"lfref.cli.{name}")
        except InputError as error:
            fail(name, error)
        # Lightning starts the other processes of a ddp run as `python ARGV[0] ...`: that must be the command itself.
        sys.argv = [str(module.__file__), *words]
        module.main()


@contextmanager
def starting(name: str) -> Iterator[None]:
    """Say on a terminal that the command starts: PyTorch takes seconds to import."""
    is_shown = sys.stderr.isatty()
    if is_shown:
        print(f"lfref {name}: starting", end="\r", file=sys.stderr, flush=True)
    yield
    if is_shown:
        print("\x1b[2K", end="\r", file=sys.stderr, flush=True)


@contextmanager
def without_collection() -> Iterator[None]:
    """Stop the garbage collector while modules are imported, and exempt PyTorch for ever: a fifth of a start's time."""
    if "torch" in sys.modules:
        yield
        return
    gc.disable()
    importlib.import_module("torch")
    gc.freeze()  # before OpenImageIO is imported, which reports objects that are left at the end
    try:
        yield
    finally:
        gc.enable()


def allowed_packages(words: list[str]) -> tuple[list[str], list[str]]:
    """A command line without its `--allow PACKAGE` (or `--allow=PACKAGE`), and these packages."""
    rest, packages, queue = [], [], list(words)
    while queue:
        word = queue.pop(0)
        if word == "--":  # only paths follow
            rest += [word, *queue]
            break
        option, equals, value = word.partition("=")
        if option != "--allow":
            rest.append(word)
        elif not equals and not queue:
            raise InputError("--allow takes a package", got="nothing", remedy="give a name such as --allow mypkg")
        else:
            packages += (value if equals else queue.pop(0)).split(",")
    return rest, packages


def usage() -> str:
    """The text of `lfref --help`."""
    commands = "\n".join(f"  {name:<9} {what}" for name, what in COMMANDS.items())
    return f"""Light-field refocusing, classical and learned.

lfref COMMAND [PATH ...] [KEY=VALUE ...]

{commands}

lfref COMMAND --help shows examples and options, --cfg job its configuration; --multirun runs KEY=A,B,C in turn.
--allow PACKAGE lets a configuration name the classes and functions of an installed package of yours."""


TEXTS: dict[str, Callable[[], str]] = {
    **dict.fromkeys(("-h", "--help", "help"), usage),
    **dict.fromkeys(("-V", "--version"), lambda: f"lfref {lfref.__version__}"),
}
"""Word that only prints a text -> function that returns the text."""


if __name__ == "__main__":
    main()
