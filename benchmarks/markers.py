"""Write measured tables into the pages, between `<!-- measured: NAME -->` and `<!-- end -->`."""

import re
from collections.abc import Mapping
from pathlib import Path

from lfref.io import atomic

ROOT = Path(__file__).resolve().parents[1]
MARKER = re.compile(r"(<!-- measured: (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def fill(lines: Mapping[str, str]) -> None:
    """Write the lines of each name into the README and the pages; markers of other names stay as they are."""

    def replacement(marker: re.Match[str]) -> str:
        start, name, _, end = marker.groups()
        return f"{start}{lines[name]}\n{end}" if name in lines else marker[0]

    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text("utf-8")
        if (new := MARKER.sub(replacement, text)) != text:
            atomic.write_text(page, new)
            print(f"wrote {page.relative_to(ROOT)}")
