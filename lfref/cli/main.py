"""The console script: `lfref COMMAND [KEY=VALUE ...]` hands over to the module of that command."""

import importlib
import sys

from lfref.cli import config, sweeps
from lfref.errors import InputError

COMMANDS = {
    "train": "train a network on labels made by an operator",
    "eval": "judge checkpoints and operators plane by plane against the label sources",
    "refocus": "refocus a light field into PNG and EXR stacks",
    "bench": "measure accuracy against time of every operator and checkpoint",
    "simulate": "write simulated light fields",
    "report": "gather runs into one page",
}


def main() -> None:
    """Run a command; status 0 if it worked, 1 if it failed, 2 if it does not exist."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help", "help"):
        print(usage())
        return
    if name not in COMMANDS:
        print(f"lfref: command must be one of {', '.join(COMMANDS)}; got {name!r}; try lfref --help", file=sys.stderr)
        sys.exit(2)
    try:
        arguments = sweeps.expanded(sys.argv[2:], config.directory("sweeps"))
    except InputError as error:
        print(f"lfref {name}: {error}", file=sys.stderr)
        sys.exit(2)
    module = importlib.import_module(f"lfref.cli.{name}")
    # Lightning starts the other processes of a ddp run as `python ARGV[0] ...`: that must be the command itself.
    sys.argv = [str(module.__file__), *arguments]
    module.main()


def usage() -> str:
    """The commands and how to learn more about each."""
    commands = "\n".join(f"  {name:<9} {what}" for name, what in COMMANDS.items())
    return f"""Light-field refocusing, classical and learned.

lfref COMMAND [KEY=VALUE ...]

{commands}

lfref COMMAND --help shows examples, --cfg job its configuration; --multirun runs KEY=A,B,C in turn."""


if __name__ == "__main__":
    main()
