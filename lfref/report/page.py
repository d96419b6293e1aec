"""The report page: one HTML file with its pictures inside, for a desk, a phone and the dark.

It needs no network and no other file: style and pictures are part of it. All text is escaped.
"""

import base64
import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import jinja2
import pandas as pd
from matplotlib.figure import Figure

from lfref.errors import FileError
from lfref.io import atomic
from lfref.report import drawing, tables

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Section:
    """A part of the page: heading, text, then figures, then tables."""

    title: str
    text: str = ""
    """Plain text; an empty line starts a paragraph."""
    figures: Mapping[str, Figure | str | Path] = field(default_factory=dict)
    """Caption -> figure, or a PNG file; screen readers read the caption too."""
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    """Caption -> table."""
    problem: str = ""
    """Why the section has no content."""

    def __post_init__(self) -> None:
        for picture in self.figures.values():
            if not isinstance(picture, Figure):
                _read_png(Path(picture))
        for table in self.tables.values():
            tables.require(table)


class _Png(NamedTuple):
    source: str
    width: int
    height: int


def write_page(path: str | Path, title: str, sections: Sequence[Section], facts: Mapping[str, object]) -> None:
    """Write the page as one file, all or nothing.

    Args:
        path: HTML file to write, usually `index.html`; an older one is replaced.
        title: Heading of the page.
        sections: In reading order; more than three get a list of contents.
        facts: Shown below the title, such as device and date.
    """
    page = jinja2.Environment(
        loader=jinja2.PackageLoader("lfref.report", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    page.filters |= {"heading": tables.heading, "cell": lambda value, column="": tables.format_cell(column, value)}
    page.filters["png"] = _png
    page.tests["numeric"] = _is_numeric
    text = page.get_template("page.html").render(title=title, sections=sections, facts=facts)
    atomic.write_text(Path(path), text.lstrip() + "\n")


def _is_numeric(column: pd.Series) -> bool:
    is_number = pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column)
    return is_number and not tables.is_text(column.name)


def _png(picture: Figure | str | Path) -> _Png:
    content = _drawn(picture) if isinstance(picture, Figure) else _read_png(Path(picture))
    source = f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"
    return _Png(source, *struct.unpack(">II", content[16:24]))


def _drawn(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, **drawing.PNG)
    return buffer.getvalue()


def _read_png(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError("a picture must be a readable PNG file", got=f"{path} ({error.strerror})") from error
    if not content.startswith(_PNG_MAGIC) or len(content) < 24:
        raise FileError("a picture must be a PNG file", got=str(path))
    return content
