"""The page in a browser: everybody can read it, on a telephone and a wide screen, by light and dark, by keyboard."""

import pandas as pd
import pytest

from lfref.report import drawing, page
from lfref.report.page import Section

WIDTHS = (390, 1280)
ANSWER = "On 30 scenes (ideal), network is 1.2 dB better than the best classical method, blockwise_wiener."


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A page with all that pages have."""
    folder = tmp_path_factory.mktemp("report")
    figure = drawing.new_figure(9, 5)
    figure.add_subplot().plot([1, 2], [3, 4])
    small = drawing.new_figure(1, 1)
    small.add_subplot()
    drawing.save_figure(small, folder / "crop.png")
    table = pd.DataFrame({f"a_long_name_of_column_{n}": [1.5, 2.5] for n in range(14)} | {"method": ["a", "b"]})
    section = Section(
        "Accuracy against time",
        "How to read it.",
        {"The front": figure, "By plane": figure, "By scene": figure},
        {"All figures": table, "": table},
        answer=ANSWER,
        crops=dict.fromkeys(("Centre view", "other", "ours", "Truth", "Difference"), folder / "crop.png"),
    )
    page.write_page(
        folder / "index.html", "A report", [section, Section("Other", "text")], {"processor": "x" * 60, "torch": "2.13"}
    )
    return folder / "index.html"


@pytest.fixture
def opened(browser, path):
    """Function (width, scheme) -> the page."""
    contexts = []

    def open_(width, scheme="light"):
        options = {"viewport": {"width": width, "height": 900}, "color_scheme": scheme}
        contexts.append(browser.new_context(**options, bypass_csp=True))
        tab = contexts[-1].new_page()
        tab.goto(path.as_uri())
        return tab

    yield open_
    for each in contexts:
        each.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_axe_finds_nothing(opened, width, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(opened(width, scheme))
    assert found.violations_count == 0, found.generate_report()


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_but_plots_and_tables_is_wider_than_the_screen(opened, width):
    tab = opened(width)
    assert tab.evaluate("() => document.documentElement.scrollWidth") == width
    wider = "() => [...document.querySelectorAll('main p, main h2, nav li, .crops, .picture, .table, dd')]"
    wider += ".filter(each => each.getBoundingClientRect().right > innerWidth).length"
    assert tab.evaluate(wider) == 0
