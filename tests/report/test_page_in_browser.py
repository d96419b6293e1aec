"""The page in a browser: everybody can read it, on a telephone and a wide screen, by light and dark, by keyboard."""

import pandas as pd
import pytest

from lfref.report import drawing, page
from lfref.report.page import Section

WIDTHS = (390, 1280, 2560)
ANSWER = "On 30 scenes (ideal), learned is 1.2 dB better than the best classical method, occlusion_aware."


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


@pytest.mark.parametrize(("width", "in_a_row"), [(390, 3), (1280, 5), (2560, 5)])
def test_crops_stand_in_a_row_on_the_first_screen(opened, width, in_a_row):
    boxes = [crop.bounding_box() for crop in opened(width).locator(".crops img").all()]
    assert len(boxes) == 5
    assert len({box["y"] for box in boxes[:in_a_row]}) == 1
    assert all(box["y"] + box["height"] < 900 for box in boxes)
    assert len({round(box["width"]) for box in boxes}) == 1


def test_the_answer_comes_first_and_the_machine_last(opened):
    tab = opened(1280)
    top = {name: tab.locator(name).first.bounding_box()["y"] for name in (".answer", ".crops", ".picture", "#machine")}
    assert top[".answer"] < top[".crops"] < top[".picture"] < 500 < top["#machine"]
    last = tab.evaluate("() => [...document.querySelectorAll('h2')].at(-1).textContent")
    assert last == "Machine and versions"


@pytest.mark.parametrize("kind", ["picture", "table"])
def test_wide_parts_scroll_by_keyboard(opened, kind):
    tab = opened(390)
    part = tab.locator(f".{kind}").first
    for _ in range(20):
        tab.keyboard.press("Tab")
        if part.evaluate("element => element === document.activeElement"):
            break
    else:
        pytest.fail("the tabulator does not reach it")
    assert part.evaluate("element => element.scrollLeft") == 0
    for _ in range(5):
        tab.keyboard.press("ArrowRight")
        tab.wait_for_timeout(50)
    tab.wait_for_function("kind => document.querySelector('.' + kind).scrollLeft > 50", arg=kind)
