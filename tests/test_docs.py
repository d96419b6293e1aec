"""Pictures and pages that a page links exist, and its code runs as written."""

import re

import pytest
import torch

from tests.conftest import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
CODE = re.compile(r"^```.*?^```$|^ {4,}.*?$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#:]*)(?:#([^)]*))?\)")
REFOCUSING, SIMULATOR = (ROOT / "docs" / f"{name}.md" for name in ("refocusing", "simulator"))
LARGEST = 120_000  # bytes of a picture


def anchors(text: str) -> set[str]:
    """Names by which the headings of a page can be linked, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_links_exists(page):
    text = page.read_text("utf-8")
    for path, anchor in LINK.findall(CODE.sub("", text)):
        target = page.parent / path if path else page
        assert target.exists(), path
        assert not anchor or anchor in anchors(target.read_text("utf-8")), anchor


def test_pictures_are_small_and_each_is_shown():
    pictures = [path for path in (ROOT / "docs" / "pictures").iterdir() if path.suffix in (".png", ".jpg")]
    shown = "".join(page.read_text("utf-8") for page in PAGES)
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size <= LARGEST, picture.name
        assert f"(pictures/{picture.name})" in shown, picture.name


def test_the_code_of_the_page_on_refocusing_runs_as_written():
    blocks = re.findall(r"^```python\n(.*?)^```$", REFOCUSING.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    names = {"views": torch.rand(7, 7, 3, 30, 36)}
    for block in blocks:
        exec(block, names)
        for name in ("stack", "back"):
            assert name not in names or bool(names[name].isfinite().all()), block
    assert names["stack"].dtype == torch.float32
    assert names["fine"].shape == (1, 3, 60, 72)
    assert names["gradient"].shape == (30, 36)
    assert names["back"].shape == names["views"].shape


def test_the_code_of_the_page_on_the_simulator_runs_as_written():
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```$", SIMULATOR.read_text("utf-8"), re.MULTILINE | re.DOTALL):
        exec(block, names)
        assert names["result"].views.shape == (7, 7, 3, 96, 144)
    assert names["result"].truth is None
