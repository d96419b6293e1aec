"""Write what was measured into the pages, between `<!-- measured: NAME -->` and `<!-- end -->`."""

import re
from collections.abc import Mapping
from pathlib import Path

from lfref.io import atomic

ROOT = Path(__file__).resolve().parents[1]
MARK = re.compile(r"(<!-- measured: (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def fill(measured: Mapping[str, str]) -> None:
    """Fill the markers of the README and the pages beside this file; those of other names stay as they are.

    Args:
        measured: Lines by name.
    """

    def filled(found: re.Match[str]) -> str:
        return f"{found[1]}{measured[found[2]]}\n{found[4]}" if found[2] in measured else found[0]

    for page in (ROOT / "README.md", *sorted(Path(__file__).parent.glob("*.md"))):
        text = page.read_text("utf-8")
        if (new := MARK.sub(filled, text)) != text:
            atomic.write_text(page, new)
            print(f"wrote {page.relative_to(ROOT)}")
