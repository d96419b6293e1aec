"""Shared by the scripts of this folder: the paper's planes, tables in Markdown, and markers of the pages.

A measured table stands between `<!-- measured: NAME code=HASH -->`, with the hash of the code that was measured, and
`<!-- end -->`.
"""

import math
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from lfref.bench import timing
from lfref.cli import config as configs
from lfref.geometry import planes_at_alphas
from lfref.io import atomic

ROOT = Path(__file__).resolve().parents[1]
PICTURES, FIGURES = ROOT / "docs" / "pictures", ROOT / "runs" / "figures"
ALPHAS = tuple(step / 8 for step in range(1, 17))
PLANES = planes_at_alphas(ALPHAS)
SIZE = (375, 540)
"""Height and width of the paper's views in pixels."""
CPU = torch.device("cpu")
LFREF = (sys.executable, "-m", "lfref.cli.main")
MARKER = re.compile(r"<!-- measured: (\w+)(?: code=(\w*))? -->\n(.*?)<!-- end -->", re.DOTALL)


def fill(tables: Mapping[str, Iterable[str]], codes: Mapping[str, str] | None = None) -> None:
    """Write the lines of each name into the README and the pages; markers of other names stay as they are.

    `codes` are the hashes of the code that was measured, of tables that were measured before.
    """
    texts = {name: filled("\n".join(lines)) for name, lines in tables.items()}
    now = timing.code_hash()

    def replacement(marker: re.Match[str]) -> str:
        name = marker[1]
        start = f"<!-- measured: {name} code={(codes or {}).get(name, now)} -->"
        return f"{start}\n{texts[name]}\n<!-- end -->" if name in texts else marker[0]

    for page in written():
        text = page.read_text("utf-8")
        if (new := MARKER.sub(replacement, text)) != text:
            atomic.write_text(page, new)
            print(f"wrote {page.relative_to(ROOT)}")


def filled(text: str) -> str:
    """A table, lists and code as they are; a paragraph is filled to the width of the pages."""
    parts = (part if part.startswith(("|", "- ", "```")) else textwrap.fill(part, 120) for part in text.split("\n\n"))
    return "\n\n".join(parts)


def written() -> Iterator[Path]:
    """The README and the pages."""
    yield ROOT / "README.md"
    yield from sorted((ROOT / "docs").glob("*.md"))


def outdated() -> list[str]:
    """Tables that were measured with other code than today's, as PAGE: NAME."""
    now = timing.code_hash()
    tables = ((page, *found) for page in written() for found in MARKER.findall(page.read_text("utf-8")))
    return [f"{page.relative_to(ROOT)}: {name}" for page, name, code, _ in tables if code != now]


def head(*headings: str) -> Iterator[str]:
    """The first row of a table, and the line below it."""
    yield row(*headings)
    yield row(*("---" for _ in headings))


def row(*cells: object) -> str:
    """A row of a table."""
    return f"| {' | '.join(map(str, cells))} |"


def number(value: float, form: str = ".1f") -> str:
    """A number as it is written; empty if it is none."""
    return "" if math.isnan(value) else f"{value:{form}}".replace("%", " %")


def machine(facts: Mapping[str, object]) -> str:
    """Processor and libraries in one line."""
    return f"{facts['processor']}, {facts['threads']} threads, torch {facts['torch']}, NumPy {facts['numpy']}"


def lfref(*words: object, **environment: str) -> None:
    """Run a command of lfref, with some variables of its environment."""
    subprocess.run([*LFREF, *map(str, words)], check=True, cwd=ROOT, env=os.environ | environment)


def composed(command: str, *overrides: str) -> DictConfig:
    """The configuration of a command."""
    with initialize_config_dir(str(configs.directory()), version_base="1.3"):
        return compose(command, list(overrides))
