"""The help of a command: its examples, options and choices, each with the comment beside it in `conf/*.yaml`.

The files are read as text. Help then appears at once, and no second table has to follow them.
"""

import re
import shutil
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import yaml

from lfref.cli import config as configs

ENTRY = re.compile(r"(?P<indent> *)(?P<item>- )?(?P<key>[\w/@.]+):(?: +(?P<value>(?!# ).*?))?(?: +# (?P<comment>.*))?")

GLOBAL = "# @package _global_"
"""Line of a file whose keys are those of the command, whatever the group."""


class Entry(NamedTuple):
    """A line `key: value # comment` of a configuration file."""

    key: str
    """The key, with those above it: `source.n_fields`."""
    value: str
    comment: str


def command_help(command: str, words: list[str]) -> str:
    """The text of `lfref COMMAND --help`; `GROUP=NAME` among the words chooses whose options are shown."""
    folder = configs.directory()
    shown = yaml.safe_load((folder / "hydra" / "help" / f"{command}.yaml").read_text(encoding="utf-8"))
    text = shown["template"].replace("${hydra.help.header}", shown["header"]).rstrip()
    own = [entry for file in (command, "base") for entry in options(folder / f"{file}.yaml")]
    lines = [text, "", "Options (KEY=VALUE):", *_rows(own)]
    listed = set[str]()
    chapters: list[str] = []
    for group in groups(folder / f"{command}.yaml"):
        name, _, place = group.key.rpartition("@")
        files = {path.stem: path for path in sorted((folder / (name or place)).glob("*.yaml"))}
        choice = next((word.partition("=")[2] for word in words if word.startswith(f"{group.key}=")), group.value)
        if len(files) > 1:
            chapters += ["", *_rows([group._replace(value=choice)])]
        if len(files) > 1 and (name or place) not in listed:
            chapters += _rows([Entry(stem, "", first_comment(path)) for stem, path in files.items()], "    ", 4)
        listed.add(name or place)
        if choice in files:
            below = [entry for entry in options(files[choice], place) if entry.comment]
            chapters += ["", f"  {group.key}={choice} has", *_rows(below, "    ")] if below else []
    lines += ["", "Choices (GROUP=NAME):", *chapters] if chapters else []
    return "\n".join([*lines, "", f"lfref {command} --cfg job shows the whole configuration."])


def defaults(command: str) -> dict[str, str]:
    """Option of a command, or of the choices that are its defaults -> default value as it is written."""
    folder = configs.directory()
    entries = [entry for name in (command, "base") for entry in options(folder / f"{name}.yaml")]
    for group in groups(folder / f"{command}.yaml"):
        name, _, place = group.key.rpartition("@")
        path = folder / (name or place) / f"{group.value}.yaml"
        entries += [group, *(options(path, place) if path.is_file() else ())]
    return {entry.key: entry.value for entry in entries}


def options(path: Path, place: str = "") -> Iterator[Entry]:
    """The options that a file of configuration sets itself, except for `hydra`.

    Args:
        place: Where the command puts the file's keys, unless the file says that they are global; empty: at the top.
    """
    above: list[tuple[int, str]] = []
    lines = path.read_text(encoding="utf-8").splitlines()
    prefix = f"{place}." if place and GLOBAL not in lines else ""
    for line in lines:
        match = ENTRY.fullmatch(line)
        if match is None or match["item"] or match["key"].startswith("_"):
            continue
        while above and len(match["indent"]) <= above[-1][0]:
            above.pop()
        keys = [*(key for _, key in above), match["key"]]
        if not match["value"]:
            above.append((len(match["indent"]), match["key"]))
        if keys[0] not in ("hydra", "defaults", "folder") and (match["value"] or match["comment"]):
            yield Entry(prefix + ".".join(keys), match["value"] or "", match["comment"] or "")


def groups(path: Path) -> Iterator[Entry]:
    """The groups in the defaults list of a command's configuration."""
    for line in path.read_text(encoding="utf-8").splitlines():
        match = ENTRY.fullmatch(line)
        if match is not None and match["item"]:
            yield Entry(match["key"].lstrip("/"), match["value"], match["comment"] or "")


def first_comment(path: Path) -> str:
    """The comment at the top of a file of configuration."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line != GLOBAL]
    end = next((n for n, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return " ".join(line.removeprefix("#").strip() for line in lines[:end])


def _rows(entries: list[Entry], indent: str = "  ", least: int = 0) -> list[str]:
    """Entries in two columns as wide as the terminal; long keys have a line of their own."""
    width = max(60, min(shutil.get_terminal_size().columns, 120))
    names = [f"{key}={value}" if value else key for key, value, _ in entries]
    column = len(indent) + 2 + max((len(name) for name in names if len(name) <= 28), default=least)
    lines = []
    for name, entry in zip(names, entries, strict=True):
        first = f"{indent}{name}  ".ljust(column)
        if len(first) > column:
            lines.append(first.rstrip())
            first = " " * column
        lines += textwrap.wrap(entry.comment, width, initial_indent=first, subsequent_indent=" " * column) or [
            first.rstrip()
        ]
    return [line for line in lines if line.strip()]
