"""The built site in a browser: accessible on every page, light and dark; its search finds what people type.

`make site` builds it, which `make test` does first; without it these tests skip.
"""

import functools
import http.server
import shutil
import threading

import pytest

from tests.conftest import ROOT

playwright = pytest.importorskip("playwright.sync_api")
axe = pytest.importorskip("axe_playwright_python.base")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SITE = ROOT / "runs" / "site"
PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html"))
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed"),
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


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser, served):
    """Function (page of the site, options of its window) -> the page, loaded."""
    contexts = []

    def open_(name, **options):
        contexts.append(browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | options))
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


@pytest.mark.parametrize(
    ("word", "page"),
    [
        ("lytro", "docs/captures.html"),
        ("raw", "docs/captures.html"),
        ("gpu", "docs/scaling.html"),
        ("browser", "docs/quickstart.html#in-the-browser"),
        ("depth", "docs/quickstart.html#a-depth-map"),
        ("onnx", "docs/deployment.html"),
    ],
)
def test_search_finds_what_people_type(opened, served, word, page):
    tab = opened("index.html")
    tab.click(".md-search__input")
    tab.locator(".md-search__input").press_sequentially(word)
    results = tab.locator(".md-search-result__item")
    results.first.wait_for()
    first = results.evaluate_all(
        "items => items.slice(0, 3).flatMap(item => [...item.querySelectorAll('a')].map(link => link.href))"
    )
    assert any(link.startswith(served + page) for link in first), first
