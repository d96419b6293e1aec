"""The page in a browser: from disk, by mouse, keyboard and finger, at any size, without the network."""

import base64
import io

import numpy as np
import pytest
import torch

from lfref.functional.psnr import psnr
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.report.refocused import Refocused
from lfref.viewer import view_page
from tests.viewer import cases

Image = pytest.importorskip("PIL.Image")
WIDE = {"viewport": {"width": 1280, "height": 900}, "reduced_motion": "reduce"}
FAR, NEAR = cases.FAR, cases.NEAR


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "index.html"
    view_page.write(
        path, "A disc <script>alert(1)</script>", {"views": "5 x 5"}, view_page.page_content(cases.methods())
    )
    return path


@pytest.fixture
def opened(browser, path):
    """Function (address, options of the browser) -> the page; in the end it has logged nothing and loaded nothing."""
    messages, requests, contexts = [], [], []

    def open_(fragment="", **options):
        contexts.append(browser.new_context(**WIDE | options))
        tab = contexts[-1].new_page()
        tab.on("console", lambda message: messages.append(message.text))
        tab.on("pageerror", lambda error: messages.append(str(error)))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto(path.as_uri() + fragment)
        tab.wait_for_function("() => drawing !== null")
        settle(tab)
        return tab

    yield open_
    for each in contexts:
        each.close()
    assert messages == []
    assert [url for url in requests if not url.startswith(("data:", "blob:", path.as_uri()))] == []


def settle(tab):
    """Wait until nothing moves, and the picture at rest is drawn."""
    tab.wait_for_function("() => !motion && !isRequested && stage.dataset.rests === 'true' && drawing.took() !== null")


def state(tab):
    return tab.evaluate("() => ({ ...lens, zoom: place.zoom, middle: place.x, by: stage.dataset.by })")


def pixels(tab, **lens):
    """What the lens draws, light [3, H, W], or a lens with other numbers."""
    height, width, values = tab.evaluate(
        """(part) => {
          drawing.draw({ ...lens, ...part });
          const read = drawing.pixels();
          return [read.height, read.width, Array.from(read.data)];
        }""",
        lens,
    )
    encoded = torch.tensor(values, dtype=torch.float64).reshape(height, width, 4)[..., :3].permute(2, 0, 1) / 255
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def saved(tab):
    """Name and encoded pixels [H, W, 3] of the picture that is saved."""
    with tab.expect_download() as waiting:
        tab.locator("#stage").press("s")
    picture = np.asarray(Image.open(waiting.value.path()).convert("RGB"), np.float64) / 255
    return waiting.value.suggested_filename, picture


def inner(stack, margin=6):
    return stack[..., margin:-margin, margin:-margin]


def in_window(tab, x, y):
    """The point of the window where a point of the picture, shares of its sides, lies."""
    box = tab.evaluate("() => currentBox()")
    return box["left"] + x * box["width"], box["top"] + y * box["height"]


def tap(tab, x, y):
    tab.mouse.click(*in_window(tab, x, y))
    settle(tab)


def drag(tab, dx, dy, start=(600, 420)):
    tab.mouse.move(*start)
    tab.mouse.down()
    tab.mouse.move(start[0] + dx, start[1] + dy, steps=4)
    tab.mouse.up()
    settle(tab)


def open_drawer(tab):
    tab.click("#more")
    settle(tab)


# The picture.


def test_the_lens_is_the_plain_sum_where_nothing_blurs(opened):
    tab = opened()
    field, truth = cases.scene()
    for slope in (FAR, NEAR):
        expected = shift_and_sum(field.views, [slope])[0].double()
        is_sharp = inner(truth - slope).abs() < 0.05
        assert is_sharp.float().mean() > 0.1
        error = inner(pixels(tab, slope=slope) - expected)[:, is_sharp].square().mean()
        assert -10 * float(error.log10()) > 40


def test_blur_is_that_of_cells_at_the_disparity_of_each_pixel(opened):
    tab = opened()
    field, disparity = cases.scene()[0], cases.methods()["linear"].disparity.disparity
    levels = torch.linspace(*disparity.aminmax(), 32)
    nearest = (disparity - levels[:, None, None]).abs().argmin(0)[None]
    for slope in (-2.0, 2.5):
        ours = inner(pixels(tab, slope=slope))
        blurred = [
            shift_and_sum(field.views, [slope], "cubic", fill_factor=1.0, disparity=d)[0] for d in levels.tolist()
        ]
        cells = torch.stack(blurred).take_along_dim(nearest[None], 0)
        plain = shift_and_sum(field.views, [slope])
        to_cells, to_plain = (float(psnr(ours, inner(stack[0].double()))) for stack in (cells, plain))
        assert to_cells > max(48, to_plain + 2)


@pytest.mark.parametrize("fragment", ["", "#plain"])
def test_views_are_restored_from_their_differences(opened, fragment):
    tab = opened(fragment)
    content = view_page.page_content(cases.methods())
    for k in (0, 7, content["views"]["reference"], 24):
        x, y = content["views"]["cameras"][k]
        view = torch.from_numpy(cases.views(content)[k]).permute(2, 0, 1)
        if fragment:  # at half the resolution, of samples that were averaged as they are encoded
            view = torch.nn.functional.avg_pool2d(view, 2)
        expected = torch.where(view <= 0.04045, view / 12.92, ((view + 0.055) / 1.055) ** 2.4)
        difference = inner(pixels(tab, slope=0, aperture=0, x=x, y=y) - expected).abs()
        assert float(difference.median()) < 0.005
        assert float(difference.square().mean().sqrt()) < 0.01


def test_samples_without_weight_leave_no_shadow(browser, tmp_path):
    field = cases.with_black_corners()
    stack = shift_and_sum_antialiased(field.views, cases.PLANES.slopes)
    content = view_page.page_content({"cells": Refocused(field, stack, cases.PLANES)})
    assert content["crop"][0] > 0
    assert len(content["views"]["masks"]) == 25
    view_page.write(tmp_path / "index.html", "corners", {}, content)
    tab = browser.new_context(**WIDE).new_page()
    tab.goto((tmp_path / "index.html").as_uri())
    tab.wait_for_function("() => drawing !== null")
    shown, whole = pixels(tab, slope=0.0), cases.scene()[0].views.mean((0, 1)).double()
    left, top, right, bottom = content["crop"]
    rows, columns = slice(round(top * 96), round(bottom * 96)), slice(round(left * 128), round(right * 128))
    corner = (..., slice(rows.start, rows.start + 8), slice(columns.start, columns.start + 8))
    assert float((shown[corner] / whole[corner]).mean()) == pytest.approx(1, abs=0.1)
    # Nor is there any where no view sees a pixel: seen from the side, and through a pinhole.
    for beside in ({"x": 1.5, "y": 1.5}, {"x": -2, "y": 1, "aperture": 0}):
        assert float(pixels(tab, slope=0.0, **beside).mean(0).min()) > 0.5 * float(whole.mean(0).min())
    tab.context.close()


# Taps.


def test_a_tap_moves_the_focus_there(opened):
    tab = opened()
    tap(tab, 0.06, 0.12)
    assert state(tab)["slope"] == pytest.approx(FAR, abs=0.05)
    assert "Focus" in tab.inner_text("#status")
    tap(tab, 0.5, 0.5)
    assert state(tab)["slope"] == pytest.approx(NEAR, abs=0.05)


@pytest.mark.parametrize(
    "part", [{}, {"tiltX": 0.8, "tiltY": -0.5}, {"x": 1.5, "y": -1.0}, {"x": -1.0, "tiltX": 0.6, "slope": 0.3}]
)
def test_taps_are_right_under_tilt_and_from_any_viewpoint(opened, part):
    field, truth = cases.scene()
    grey = field.views[2, 2].mean(0).numpy()
    y, x = np.nonzero(np.hypot(*np.gradient(grey)) > 0.03)
    chosen = np.random.default_rng(0).permutation(len(y))[:100]
    tab = opened()
    misses = tab.evaluate(
        """([points, part]) => points.map(([x, y, disparity]) => {
          const from = { ...WHOLE, ...part };
          // Where the point of the central view lies in the picture, by steps towards it.
          let at = [x, y];
          for (let step = 0; step < 20; step++) {
            const slope = localSlope(from, at);
            at = [x + ((disparity - slope) * from.x) / WIDTH, y + ((disparity - slope) * from.y) / HEIGHT];
          }
          const shown = visiblePoint(from, at, (point) => disparityOf(pixelAt(point)), SCENE);
          const slope = focusOn(from, shown, disparityNear(shown).disparity);
          return localSlope({ ...from, slope }, [x, y]) - disparity;
        })""",
        [
            [[(c + 0.5) / 128, (r + 0.5) / 96, float(truth[r, c])] for r, c in zip(y[chosen], x[chosen], strict=True)],
            part,
        ],
    )
    # Half a step of the planes; points that another surface hides from this viewpoint are not there to be tapped.
    assert (np.abs(misses) < 0.25).mean() >= 0.95


# Gestures.


def test_a_drag_looks_around_and_near_things_follow_it(opened):
    tab = opened()
    tap(tab, 0.06, 0.12)  # the wall stays where it is, the disc moves
    before = pixels(tab, aperture=0)
    drag(tab, 150, 0)
    assert state(tab)["x"] > 0.3
    assert state(tab)["y"] == 0
    after = pixels(tab, aperture=0)
    weight = [(light[1] - light[0]).clamp(min=0) for light in (before, after)]
    centres = [float((each * torch.arange(128)).sum() / each.sum()) for each in weight]
    assert centres[1] > centres[0] + 0.2


def test_shift_tilts_and_control_moves_the_enlarged_picture(opened):
    tab = opened()
    tab.keyboard.down("Shift")
    drag(tab, 100, -50)
    tab.keyboard.up("Shift")
    tilted = state(tab)
    assert tilted["tiltX"] > 0.1
    assert tilted["tiltY"] < 0
    tab.locator("#stage").press("+")
    tab.keyboard.down("Control")
    drag(tab, 100, 0)
    tab.keyboard.up("Control")
    assert state(tab)["middle"] < 0.5
    assert state(tab)["tiltX"] == tilted["tiltX"]


def test_two_fingers_zoom(opened):
    tab = opened(viewport={"width": 390, "height": 844}, has_touch=True)
    session = tab.context.new_cdp_session(tab)

    def touch(kind, *points):
        touched = [{"x": x, "y": y, "id": n} for n, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touched})

    touch("touchStart", (150, 400))
    touch("touchStart", (150, 400), (250, 400))
    touch("touchMove", (100, 400), (300, 400))
    touch("touchEnd")
    settle(tab)
    assert state(tab)["zoom"] == pytest.approx(2, rel=0.05)
    assert state(tab)["slope"] == pytest.approx(NEAR, abs=0.05), "a pinch is no tap"


# Keys and sliders.


def test_every_key_does_what_the_page_says(opened):
    tab = opened()
    stage, lens = tab.locator("#stage"), lambda: tab.evaluate("() => ({ ...lens })")
    for key, changes in {
        "ArrowRight": {"x": 0.2},
        "ArrowUp": {"y": -0.2},
        "Shift+ArrowLeft": {"tiltX": -2 * 2 * 20 / 1280},
        "[": {"aperture": 3.6},
        "]": {"aperture": 4.0},
        "Home": {"slope": 1.0},
        "End": {"slope": -1.0},
        "PageUp": {"slope": -0.96},
    }.items():
        before = lens()
        stage.press(key)
        settle(tab)
        after = lens()
        assert {name: after[name] for name in changes} == pytest.approx(changes), key
        assert {name for name in after if after[name] != before[name]} == {*changes}
    stage.press("0")
    settle(tab)
    whole = tab.evaluate("() => ({ ...WHOLE })")
    assert lens() == whole
    stage.press("Home")
    stage.press("Enter")
    settle(tab)
    assert lens()["slope"] == pytest.approx(NEAR, abs=0.05), "the middle of the picture"


# The drawer.


def test_methods_are_compared_without_loss(opened):
    tab = opened("#f=-0.5")
    open_drawer(tab)
    tab.check("#compare")
    settle(tab)
    assert state(tab)["by"] == "compare"
    canvas = tab.evaluate("() => flatCanvas.toDataURL('image/png')").partition(",")[2]
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(canvas))).convert("RGB"), np.float64) / 255
    box = tab.evaluate("() => boxOf(place, [flatCanvas.width, flatCanvas.height], crop, SIZE)")
    for x, name in ((0.25, "linear"), (0.75, "dim")):
        refocused = cases.methods()[name]
        expected = refocused.encoded(refocused.stack[cases.PLANES.values.index(-0.5)])
        left, top = (int(box["left"] + x * box["width"]), int(box["top"] + 0.5 * box["height"]))
        size = int(box["width"] / 128 * 4)
        own = shown[top - size : top + size, left - size : left + size].mean((0, 1))
        row, column = 48, int(x * 128)
        assert own == pytest.approx(expected[row - 4 : row + 4, column - 4 : column + 4].mean((0, 1)), abs=0.01)
    tab.check("#difference")
    settle(tab)
    difference = tab.evaluate(
        "() => Array.from(flat.getImageData(flatCanvas.width / 2, flatCanvas.height / 2, 1, 1).data)"
    )
    assert max(difference[:3]) == 255, "8 times a difference of two fifths"


def test_the_picture_is_saved_in_its_own_pixels_with_its_focus_in_the_name(opened):
    tab = opened("#f=0.25&a=2")
    settle(tab)
    name, picture = saved(tab)
    assert name == "A_disc_script_alert_1_script_slope_0.25.png"
    light = pixels(tab).permute(1, 2, 0).numpy()
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    assert np.abs(picture - encoded).max() < 0.01


# The address, and a page around this one.


def test_the_address_holds_the_state_and_opens_it(opened):
    tab = opened()
    tap(tab, 0.06, 0.12)
    drag(tab, 100, 40)
    address = tab.evaluate("() => location.hash")
    again = opened(address)
    for name in ("slope", "x", "y", "aperture"):
        assert again.evaluate(f"() => lens.{name}") == pytest.approx(tab.evaluate(f"() => lens.{name}"), abs=1e-3)
    again.evaluate("() => { location.hash = '#f=0.5&a=1'; }")
    again.wait_for_function("() => lens.slope === 0.5")
    assert again.evaluate("() => lens.aperture") == 1


def test_an_embedded_page_shows_the_picture_alone_and_listens(browser, path, tmp_path):
    frame = f'<iframe src="{path.as_uri()}#embed&f=0.5" width=600 height=400></iframe>'
    script = "<script>said = []; onmessage = (event) => said.push(event.data.lfref);</script>"
    (tmp_path / "around.html").write_text(f"<!doctype html>{script}{frame}")
    tab = browser.new_context(**WIDE).new_page()
    tab.goto((tmp_path / "around.html").as_uri())
    inside = tab.frames[1]
    inside.wait_for_function("() => drawing !== null && lens.slope === 0.5")
    for hidden in (".edge", ".corner", "h1"):
        assert inside.locator(hidden).is_hidden()
    tab.evaluate("() => frames[0].postMessage({ lfref: 'f=-0.25&a=2' }, '*')")
    inside.wait_for_function("() => lens.slope === -0.25 && lens.aperture === 2")
    tab.wait_for_function("() => said.includes('f=-.25&a=2')")
    tab.context.close()


# For everybody.


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 900)])
def test_axe_finds_nothing(opened, width, height, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    tab = opened(viewport={"width": width, "height": height}, color_scheme=scheme, bypass_csp=True)
    for opens in (False, True):
        if opens:
            open_drawer(tab)
        found = axe.Axe().run(tab)
        assert found.violations_count == 0, found.generate_report()


@pytest.fixture
def in_parts(tmp_path, monkeypatch):
    """A page whose pictures lie in a folder beside it."""
    monkeypatch.setattr(view_page, "MOST_BYTES", 1000)
    path = tmp_path / "some page" / "index.html"
    written = view_page.write(path, "In parts", {}, view_page.page_content(cases.methods()))
    assert written == [path, path.parent / "index_pictures"]
    return path


def test_a_large_page_loads_its_pictures_from_the_folder_beside_it(browser, in_parts, opened):
    whole = opened(f"#f={NEAR}&a=2")
    tab = browser.new_context(**WIDE).new_page()
    messages = []
    tab.on("console", lambda message: messages.append(message.text))
    tab.goto(in_parts.as_uri() + f"#f={NEAR}&a=2")
    tab.wait_for_function("() => drawing !== null")
    settle(tab)
    assert torch.equal(pixels(tab), pixels(whole))
    tab.locator("#more").click()
    tab.locator("#show_sharp").check()
    settle(tab)
    assert state(tab)["by"] == "sharp"
    assert messages == []
    assert len(in_parts.read_text()) < 300_000
    tab.context.close()


@pytest.mark.parametrize(
    "lack",
    [
        "WebGL2RenderingContext.prototype.getExtension = () => null",
        "WebGL2RenderingContext.prototype.getError = () => WebGL2RenderingContext.OUT_OF_MEMORY",
    ],
)
def test_the_processor_draws_where_the_graphics_processor_cannot(browser, path, lack):
    context = browser.new_context(**WIDE)
    context.add_init_script(lack)
    tab = context.new_page()
    errors = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(path.as_uri() + f"#f={NEAR}&a=3")
    tab.wait_for_function("() => drawing !== null")
    settle(tab)
    assert tab.locator("#live").get_attribute("data-by") == "canvas"
    assert pixels(tab).mean() > 0.1
    assert errors == []
    context.close()
