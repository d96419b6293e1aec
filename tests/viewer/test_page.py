"""The page in a browser: from disk, by mouse, keyboard and finger, wide and narrow, without the network."""

import re
import shutil

import numpy as np
import pytest

from lfref.viewer import view_page
from tests.viewer import cases

playwright = pytest.importorskip("playwright.sync_api")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
SOFTWARE = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Graphics by the processor: test machines have no other."""


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "index.html"
    view_page.write(
        path, "A disc <script>alert(1)</script>", {"views": "5 x 5"}, view_page.page_content(cases.methods())
    )
    return path


@pytest.fixture
def opened(browser, path):
    """Function (options of the page) -> the page; in the end it has logged no message and loaded nothing."""
    messages, requests, contexts = [], [], []

    def open_(fragment="", **options):
        contexts.append(browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | options))
        tab = contexts[-1].new_page()
        tab.on("console", lambda message: messages.append(message.text))
        tab.on("pageerror", lambda error: messages.append(str(error)))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto(path.as_uri() + fragment)
        tab.wait_for_selector("#stage[data-drawn=planes]")
        return tab

    yield open_
    for each in contexts:
        each.close()
    assert messages == []
    assert [url for url in requests if not url.startswith(("data:", "blob:", path.as_uri()))] == []


def pixels(tab, canvas="flat"):
    """What a canvas shows, [H, W, 3] of 0 to 255."""
    values = tab.evaluate(
        """async (name) => {
          const from = document.getElementById(name), made = document.createElement("canvas");
          [made.width, made.height] = [from.width, from.height];
          const context = made.getContext("2d");
          context.drawImage(from, 0, 0);
          const data = context.getImageData(0, 0, made.width, made.height).data;
          return [made.height, made.width, Array.from(data)];
        }""",
        canvas,
    )
    return np.array(values[2], np.float64).reshape(values[0], values[1], 4)[..., :3]


def click(tab, x, y):
    """Click a pixel of the picture and wait until the focus has moved."""
    box = tab.locator("#stage").bounding_box()
    tab.mouse.click(box["x"] + (x + 0.5) / 128 * box["width"], box["y"] + (y + 0.5) / 96 * box["height"])
    settle(tab)


def settle(tab):
    """Wait until nothing moves, and what is asked for is drawn."""
    tab.wait_for_function("() => motion === 0")
    tab.evaluate("() => draw()")


def plane(tab):
    return int(tab.get_attribute("#stage", "data-plane"))


def expected_plane(slope, name="linear"):
    refocused = cases.methods()[name]
    return 255 * refocused.encoded(refocused.stack[cases.PLANES.values.index(slope)])


def test_a_click_focuses_on_what_was_clicked(opened):
    tab = opened()
    click(tab, 64, 48)
    assert plane(tab) == 4
    assert "nearest plane: slope 1" in tab.inner_text("#status")
    assert np.abs(pixels(tab) - expected_plane(1.0)).mean() < 3
    click(tab, 8, 12)
    assert plane(tab) == 1
    assert np.abs(pixels(tab) - expected_plane(-0.5)).mean() < 3
    assert tab.locator("#mark").is_visible()


def test_the_plane_under_a_click_is_the_nearest_one_wherever_there_is_texture(opened):
    field, truth = cases.scene()
    grey = field.views[2, 2].mean(0).numpy()
    y, x = np.nonzero(np.hypot(*np.gradient(grey)) > 0.03)
    assert len(y) > 1000
    found = opened().evaluate(
        "(points) => points.map(([x, y]) => nearestPlane(slopeAt(x, y).slope))", np.stack([x, y], 1).tolist()
    )
    rising = np.array(sorted(cases.PLANES.values))
    nearest = np.abs(rising[:, None] - truth.numpy()[y, x]).argmin(0)
    assert (np.array(found) == nearest).mean() >= 0.95


def test_a_click_on_unknown_disparity_keeps_the_focus(opened):
    tab = opened()
    tab.evaluate("() => depth.confidence.fill(0)")
    before = plane(tab)
    click(tab, 64, 48)
    assert plane(tab) == before
    assert "disparity there is unknown" in tab.inner_text("#status")


def test_the_slider_and_the_keyboard_move_the_focus(opened):
    tab = opened()
    tab.locator("#plane").fill("0")
    settle(tab)
    assert plane(tab) == 0
    assert tab.inner_text("#plane_text") == "slope -1, alpha 0.5"
    assert np.abs(pixels(tab) - expected_plane(-1.0)).mean() < 3
    tab.locator("#stage").focus()
    for key, expected in (
        ("ArrowRight", 1),
        ("ArrowUp", 2),
        ("ArrowLeft", 1),
        ("End", 4),
        ("ArrowRight", 4),
        ("Home", 0),
    ):
        tab.keyboard.press(key)
        assert plane(tab) == expected


def test_a_sweep_goes_through_the_planes_until_it_is_stopped(opened):
    tab = opened()
    tab.click("#sweep")
    planes = set()
    for _ in range(200):
        tab.wait_for_timeout(30)
        planes.add(plane(tab))
        if len(planes) == 5:
            break
    assert planes == {0, 1, 2, 3, 4}
    tab.locator("#stage").focus()
    tab.keyboard.press(" ")
    assert tab.get_attribute("#sweep", "aria-pressed") == "false"
    still = plane(tab)
    tab.wait_for_timeout(400)
    assert plane(tab) == still


def test_the_wipe_shows_two_methods_beside_each_other(opened):
    tab = opened()
    tab.locator("#plane").fill("1")
    tab.locator("#wipe").fill("50")
    settle(tab)
    made = pixels(tab)
    for half, name in ((np.s_[:, :60], "linear"), (np.s_[:, 68:], "dim")):
        assert np.abs(made[half] - expected_plane(-0.5, name)[half]).mean() < 3


@pytest.mark.parametrize(("fragment", "by"), [("", "webgl"), ("#plain", "canvas")])
def test_the_lens_sums_the_views_as_shift_and_sum_does(opened, fragment, by):
    tab = opened(fragment)
    tab.locator("#plane").fill("4")
    tab.check("input[value=lens]")
    tab.wait_for_selector("#stage[data-drawn=lens]")
    assert tab.get_attribute("#lens", "data-by") == by
    own, other = (np.abs(coarse(pixels(tab, "lens")) - coarse(expected_plane(slope))).mean() for slope in (1.0, -0.5))
    assert own < 3
    assert other > 2 * own


def coarse(picture):
    """Of 48 by 64 pixels, without the border."""
    side = len(picture) // 48
    return picture.reshape(48, side, 64, side, 3).mean((1, 3))[6:-6, 6:-6]


def test_a_small_aperture_shows_one_view_and_the_viewpoint_moves_it(opened):
    tab = opened()
    tab.check("input[value=lens]")
    tab.wait_for_selector("#stage[data-drawn=lens]")
    tab.locator("#slope").fill("0")
    tab.locator("#aperture").fill("0")
    field, _ = cases.scene()
    shown = cases.methods()["linear"]
    for across, down, view in ((0, 0, (2, 2)), (2, -1, (1, 4))):
        tab.locator("#across").fill(str(across))
        tab.locator("#down").fill(str(down))
        settle(tab)
        assert np.abs(pixels(tab, "lens") - 255 * shown.encoded(field.views[view])).mean() < 3
    tab.click("#reset")
    assert tab.input_value("#aperture") == "4"


def test_other_pictures_are_shown_and_saved(opened):
    tab = opened()
    for mode in ("sharp", "map"):
        tab.check(f"input[value={mode}]")
        tab.wait_for_selector(f"#stage[data-drawn={mode}]")
        assert tab.locator(".bar").is_visible() == (mode == "map")
    assert re.fullmatch(
        r"-?\d\.\d\d slope, px per view step \d\.\d\d", tab.locator(".ends").first.inner_text().replace("\n", " ")
    )
    with tab.expect_download() as waiting:
        tab.click("#save")
    assert waiting.value.suggested_filename.startswith("map_")
    click(tab, 64, 48)
    assert tab.is_checked("input[value=planes]")
    assert plane(tab) == 4


def test_a_narrow_screen_and_a_finger_do(opened):
    tab = opened(viewport={"width": 390, "height": 844}, has_touch=True)
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    box = tab.locator("#stage").bounding_box()
    assert box["width"] > 350
    tab.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    settle(tab)
    assert plane(tab) == 4


def test_reduced_motion_moves_the_focus_at_once(opened):
    tab = opened(reduced_motion="reduce")
    box = tab.locator("#stage").bounding_box()
    tab.locator("#plane").fill("0")
    tab.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert plane(tab) == 4, "at once"


def test_every_control_has_a_name_and_titles_are_no_programs(opened):
    tab = opened()
    assert tab.inner_text("h1") == "A disc <script>alert(1)</script>"
    unnamed = tab.evaluate(
        """() => [...document.querySelectorAll("input, select, button")]
          .filter((each) => !(each.labels?.length || each.textContent.trim())).map((each) => each.id)"""
    )
    assert unnamed == []
