"""The built site in a browser: accessible on every page, light and dark; a click refocuses its first picture.

`make site` builds it, which `make test` does first; without it these tests skip.
"""

import functools
import http.server
import re
import threading

import pytest

import lfref
from tests.conftest import ROOT

axe = pytest.importorskip("axe_playwright_python.base")
SITE = ROOT / "runs" / "site"
PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html"))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PAGES, reason="`make site` builds the site"),
]
# The page of an unknown address asks the root of the server for its style, so that the site is served here, not opened.
WITHOUT_TRANSITIONS = "*, *::before, *::after { transition: none !important; animation: none !important }"
VIOLATIONS = """async (rules) => {
  const options = { resultTypes: ["violations"] };
  if (rules) options.runOnly = { type: "rule", values: rules };
  const { violations } = await axe.run(document, options);
  return violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html.slice(0, 200)).join(", ")}`);
}"""
OF_COLOURS = ["color-contrast", "link-in-text-block"]


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Serves files without a line for each."""

    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def served():
    """Address of the site."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=SITE))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}/"
    server.shutdown()
    server.server_close()


@pytest.fixture
def opened(browser, served):
    """Function (page of the site, options of its window) -> the page, loaded."""
    contexts = []

    def open_(name, **options):
        contexts.append(
            browser.new_context(**{"viewport": {"width": 1280, "height": 900}, "bypass_csp": True} | options)
        )
        tab = contexts[-1].new_page()
        tab.goto(served + name)
        tab.add_style_tag(content=WITHOUT_TRANSITIONS)
        return tab

    yield open_
    for context in contexts:
        context.close()


@pytest.mark.parametrize("name", PAGES)
def test_axe_finds_nothing(opened, name):
    tab = opened(name, color_scheme="light")
    tab.evaluate(axe.AXE_FILE_PATH.read_text("utf-8"))
    assert tab.evaluate(VIOLATIONS, None) == []
    tab.evaluate("document.body.dataset.mdColorScheme = 'slate'")
    assert tab.evaluate(VIOLATIONS, OF_COLOURS) == []


def test_a_click_refocuses_the_picture_that_opens_the_site(opened):
    tab = opened("index.html", reduced_motion="reduce")
    picture = tab.frame_locator("iframe.living").locator("canvas").first
    picture.wait_for()
    living = next(frame for frame in tab.frames if "living" in frame.url)
    rests = "() => drawing !== null && !motion && stage.dataset.rests === 'true'"
    living.wait_for_function(rests)
    box = picture.bounding_box()
    assert box["width"] > 300
    # The upper right is far from the click and its mark; the leaves there are sharp until a lamp far away is clicked.
    width, height = box["width"] * 0.3, box["height"] * 0.4
    part = {"x": box["x"] + box["width"] * 0.7, "y": box["y"], "width": width, "height": height}
    before = tab.screenshot(clip=part)
    assert tab.screenshot(clip=part) == before
    tab.mouse.click(box["x"] + box["width"] * 0.08, box["y"] + box["height"] * 0.225)
    living.wait_for_function(f"() => lens.slope < -1 && ({rests})()")
    assert tab.screenshot(clip=part) != before


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280, 2560])
def test_no_page_is_wider_than_the_window(opened, width, scheme):
    tab = opened("index.html", viewport={"width": width, "height": 900}, color_scheme=scheme)
    assert tab.evaluate("document.documentElement.scrollWidth") == width


def test_every_public_name_leads_to_its_description():
    names = (SITE / "reference" / "names.html").read_text("utf-8")
    for name, home in lfref._HOMES.items():
        (page, anchor), *_ = re.findall(rf'href="([^"#]*)#({re.escape(home)}\.{name})"', names) or [("", name)]
        assert page, name
        described = (SITE / "reference" / page).read_text("utf-8")
        assert f'id="{anchor}"' in described, name
