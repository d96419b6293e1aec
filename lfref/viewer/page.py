"""Writing the page: style, programs and pictures in one file, which asks nobody for anything.

What may run in it is named by its hash, so that a title or a file name can bring in no program of its own.
"""

import base64
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from lfref.io import atomic

PROGRAMS = ("pictures.js", "lens.js", "controls.js")
"""In the order in which they are run."""


def write(path: Path, title: str, facts: Mapping[str, object], held: Mapping[str, Any]) -> None:
    """Write the page, all or nothing.

    Args:
        path: HTML file to write.
        title: Its heading.
        facts: What the reader should know, by name.
        held: Of `content`.

    Raises:
        FileError: The disk refuses.
    """
    loaders = {"report": jinja2.PackageLoader("lfref.report", "."), "viewer": jinja2.PackageLoader("lfref.viewer", ".")}
    pages = jinja2.Environment(
        loader=jinja2.PrefixLoader(loaders),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    program = "".join((Path(__file__).parent / name).read_text(encoding="utf-8") for name in PROGRAMS)
    text = pages.get_template("viewer/view.html").render(
        title=title,
        facts=facts,
        held=held,
        program=Markup(program),
        hash=base64.b64encode(hashlib.sha256(program.encode()).digest()).decode(),
        data=Markup(_harmless(json.dumps(held, separators=(",", ":")))),
    )
    atomic.write_text(path, text.lstrip() + "\n")


def _harmless(text: str) -> str:
    """JSON that ends no element that it stands in."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
