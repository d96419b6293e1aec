"""The page is one file that needs nothing else, holds its pictures, and escapes what people write."""

import base64
import re
from html.parser import HTMLParser

import pandas as pd
import pytest

from lfref.report import drawing, page, tables
from lfref.report.page import Section

EMPTY_TAGS = {"meta", "img", "wbr"}


class Outline(HTMLParser):
    """Collects tags, attributes and text, and checks that every tag is closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.texts = [], [], {}
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in EMPTY_TAGS:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open:
            self.texts.setdefault(self.open[-1], []).append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture
def figure():
    figure = drawing.new_figure(2, 1)
    figure.add_subplot().plot([1, 2], [3, 4])
    return figure


def written(tmp_path, sections, facts=None, title="Title"):
    path = tmp_path / "index.html"
    page.write_page(path, title, sections, facts or {})
    return path.read_text("utf-8")


def test_pictures_are_inside_with_their_caption_as_alternative_text(tmp_path, figure):
    file = tmp_path / "saved.png"
    drawing.save_figure(figure, file)
    text = written(tmp_path, [Section("Plots", figures={'drawn "now"': figure, "saved": file})])
    drawn, saved = Outline(text).all("img")
    assert (drawn["alt"], saved["alt"]) == ('drawn "now"', "saved")
    prefix = "data:image/png;base64,"
    assert base64.b64decode(saved["src"].removeprefix(prefix)) == file.read_bytes()
    assert base64.b64decode(drawn["src"].removeprefix(prefix)).startswith(b"\x89PNG")
    assert int(saved["width"]) > int(saved["height"]) > 0


def test_the_page_asks_for_nothing_from_outside(tmp_path, figure):
    text = written(tmp_path, [Section("Plots", figures={"drawn": figure})])
    assert not re.findall(r'(?:src|href)="(?!data:|#)', text)
    assert "url(" not in text
    assert "@import" not in text
    assert "default-src 'none'" in text
    assert "{{" not in text


def test_all_text_is_escaped(tmp_path, figure):
    evil = "<script>alert('&')</script> {{ title }} $title"
    section = Section(evil, evil, {evil: figure}, {evil: pd.DataFrame([{evil: evil}])})
    text = written(tmp_path, [section] * 4, {evil: evil}, title=evil)
    outline = Outline(text)
    assert not outline.all("script")
    texts = outline.texts
    shown = [texts[tag][0] for tag in ("title", "h1", "h2", "p", "dt", "dd", "a", "th", "td", "figcaption")]
    assert shown == [evil] * 10


def test_tables_have_headings_and_numbers_to_the_right(tmp_path):
    rows = pd.DataFrame({"method": ["<b>&'", None], "psnr_db": [31.256, 100.0]})
    outline = Outline(written(tmp_path, [Section("Part", tables={"": rows})]))
    assert outline.texts["th"] == ["Method", "PSNR (dB)"]
    assert outline.all("th") == [{"scope": "col"}, {"scope": "col", "class": "number"}]
    assert outline.texts["td"] == ["<b>&'", "31.26", tables.DASH, "≥ 100"]
    assert outline.all("td") == [{}, {"class": "number"}] * 2
