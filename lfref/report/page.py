"""The report page: one HTML file with style and pictures inside, for wide, narrow and dark screens."""

import base64
import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jinja2
import pandas as pd
from matplotlib.figure import Figure

from lfref.io import atomic
from lfref.report import drawing, tables

LEGIBLE = 0.39
"""Share of a plot's own width, at 150 dots per inch, at which text of 10 points has 8 pixels of a screen."""


@dataclass(frozen=True)
class Section:
    """A part of the page: heading, answer, crops, the first figure, text, the other figures, tables."""

    title: str
    text: str = ""
    """How to read what is shown, as plain text."""
    figures: Mapping[str, Figure | Path] = field(default_factory=dict)
    """Caption -> figure, or a PNG file; screen readers read the caption too."""
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    files: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    """Name of a CSV file beside the page -> its table."""
    answer: str = ""
    """What the run answers, with its figures, in one sentence."""
    crops: Mapping[str, Path] = field(default_factory=dict)
    """Caption -> PNG file; all are shown in one row."""


def write_page(
    path: str | Path, title: str, sections: Sequence[Section], facts: Mapping[str, object], text: str = ""
) -> None:
    """Write the page, all or nothing: the text below the heading, the sections after their answers, the facts."""
    loader, strict = jinja2.PackageLoader("lfref.report", "."), jinja2.StrictUndefined
    page = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=strict)
    page.filters |= {"heading": tables.heading, "cell": lambda value, column="": tables.format_cell(column, value)}
    page.filters["png"] = _png
    page.tests["numeric"] = lambda column: column.dtype.kind in "iuf" and column.name not in tables.NAMES
    text = page.get_template("page.html").render(title=title, text=text, sections=sections, facts=facts)
    atomic.write_text(Path(path), text.lstrip() + "\n")


def _png(picture: Figure | Path) -> dict[str, object]:
    """Source, width and height of an image element, and the least width at which its text can be read."""
    if isinstance(picture, Figure):
        buffer = io.BytesIO()
        picture.savefig(buffer, **drawing.PNG)
        content = buffer.getvalue()
    else:
        content = picture.read_bytes()
    width, height = struct.unpack(">II", content[16:24])  # of the PNG header
    source = f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"
    return {"source": source, "width": width, "height": height, "least_width": round(LEGIBLE * width)}
