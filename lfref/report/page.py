"""The report page: one HTML file with its pictures inside, for a desk, a phone and the dark.

It needs no network and no other file: style and pictures are part of it. All text is escaped.
"""

import base64
import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from matplotlib.figure import Figure

from lfref.errors import FileError
from lfref.io import atomic
from lfref.report import drawing, tables, wording
from lfref.report.tables import Row

CONTENTS_FROM = 4
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Section:
    """A part of the page: heading, text, then figures, then tables."""

    title: str
    text: str = ""
    """Plain text; an empty line starts a paragraph."""
    figures: Mapping[str, Figure | str | Path] = field(default_factory=dict)
    """Caption: figure, or a PNG file. The caption also is what a screen reader says for the picture."""
    tables: Mapping[str, Sequence[Row]] = field(default_factory=dict)
    """Caption: rows, shown as `lfref.report.tables.to_html` shows them."""


def write_page(path: str | Path, title: str, sections: Sequence[Section], facts: Mapping[str, object]) -> None:
    """Write the page as one file, all or nothing.

    Args:
        path: HTML file to write, usually `index.html`; an older one is replaced.
        title: Heading of the page.
        sections: Parts in reading order; with more than three of them the page gets a list of contents.
        facts: What the reader should know at once (model, data, device, date), shown below the title.

    Raises:
        FileError: A picture given by its path is missing or no PNG.
        InputError: A table has no rows.
    """
    page = Template(_resource("page.html")).substitute(
        title=escape(title),
        style=_resource("page.css"),
        facts=_facts(facts),
        contents=_contents(sections) if len(sections) >= CONTENTS_FROM else "",
        sections="\n".join(_section(number, section) for number, section in enumerate(sections, start=1)),
    )
    atomic.write_text(Path(path), page)


def _resource(name: str) -> str:
    return resources.files("lfref.report").joinpath(name).read_text("utf-8")


def _facts(facts: Mapping[str, object]) -> str:
    pairs = (f"<div><dt>{escape(key)}</dt><dd>{escape(_fact(value))}</dd></div>" for key, value in facts.items())
    return f"<dl>\n{chr(10).join(pairs)}\n</dl>" if facts else ""


def _fact(value: object) -> str:
    return wording.cell_for_people("", value)


def _contents(sections: Sequence[Section]) -> str:
    links = (
        f'<li><a href="#section-{number}">{escape(section.title)}</a></li>'
        for number, section in enumerate(sections, start=1)
    )
    return f'<nav aria-label="Contents"><ol>{"".join(links)}</ol></nav>'


def _section(number: int, section: Section) -> str:
    parts = [
        f'<section id="section-{number}">\n<h2>{escape(section.title)}</h2>',
        *(f"<p>{escape(paragraph)}</p>" for paragraph in _paragraphs(section.text)),
        *(_figure(caption, picture) for caption, picture in section.figures.items()),
        *(_table(caption, rows) for caption, rows in section.tables.items()),
        "</section>",
    ]
    return "\n".join(parts)


def _paragraphs(text: str) -> list[str]:
    return [paragraph.strip() for paragraph in text.split("\n\n") if paragraph.strip()]


def _figure(caption: str, picture: Figure | str | Path) -> str:
    png = _png(picture) if isinstance(picture, Figure) else _read_png(Path(picture))
    width, height = struct.unpack(">II", png[16:24])
    source = f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
    text = escape(caption)
    image = f'<img src="{source}" alt="{text}" width="{width}" height="{height}">'
    return f'<figure><div class="picture">{image}</div>\n<figcaption>{text}</figcaption></figure>'


def _png(figure: Figure) -> bytes:
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


def _table(caption: str, rows: Sequence[Row]) -> str:
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><div class="table">\n{tables.to_html(rows)}\n</div>\n{text}</figure>'
