"""The page of `lfref view`: how soon it shows a picture, how fast it follows, what it looks like.

`python benchmarks/browsing.py` leaves `runs/figures/browsing/browsing.json`, from which `measure.py browsing` makes a
paragraph, and `page.png`, from which `pictures.py page.jpg` makes a picture.
"""

import json
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from lfref.io import images
from lfref.report import drawing

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "browsing"
SCENE, TAP = "thicket", (0.535, 0.57)
"""Scene of the picture of the page, and the point that is tapped, on a twig: shares of width and height."""
WINDOW, PIXELS_WIDE = (1100, 755), 900
"""Size of the window, and width of the picture, in pixels."""
GRID, SIZE, LOADS, N_EVENTS = (9, 9), (375, 540), 7, 20
VIEWPORT = {"width": 1280, "height": 900}
UNTOUCHED_MS = 2000
"""Milliseconds in which a page has painted its first picture."""
FIRST_PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"
RESTS = "() => stage.dataset.rests === 'true' && !motion && !isRequested && drawing.took() !== null"
EVENTS = """async (n) => {
  const slider = find("focus");
  for (let k = 0; k < n; k++) {
    slider.value = k / (n - 1);
    slider.dispatchEvent(new Event("input"));
    await new Promise((next) => setTimeout(next, 16));
  }
  const last = performance.now();
  while (isRequested || drawing.took() === null) await new Promise((next) => setTimeout(next, 4));
  return performance.now() - last;
}"""
"""Milliseconds from the last of n events of a slider until what it asks for is drawn."""


@contextmanager
def chromium() -> Iterator[Any]:
    """The Chromium that is installed, with graphics by the processor where there is no other."""
    from playwright.sync_api import sync_playwright  # only who measures needs it

    graphics = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=graphics)
        yield browser
        browser.close()


def opened(browser: Any, page: Path, **options: Any) -> Any:
    """A page whose lens is ready and rests."""
    tab = browser.new_context(**{"viewport": VIEWPORT, "reduced_motion": "reduce"} | options)
    tab = tab.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_function("() => drawing !== null")
    tab.wait_for_function(RESTS)
    return tab


def measure(page: Path) -> dict[str, Any]:
    """Milliseconds that a page of `lfref view` takes to its first picture, to its lens, and to follow a slider."""
    paints, ready, following = [], [], []
    with chromium() as browser:
        for _ in range(LOADS):
            # Nothing asks the page before it has painted: questions take time on the thread that paints.
            untouched = browser.new_context(viewport=VIEWPORT, reduced_motion="reduce").new_page()
            untouched.goto(page.as_uri())
            untouched.wait_for_timeout(UNTOUCHED_MS)
            paints.append(untouched.evaluate(FIRST_PAINT))
            untouched.context.close()
            tab = opened(browser, page)
            ready.append(tab.evaluate("() => readyAt"))
            following.append(tab.evaluate(EVENTS, N_EVENTS))
            tab.context.close()
        version = browser.version
    times = {"paint_ms": paints, "ready_ms": ready, "following_ms": following}
    return {
        "version": version,
        "megabytes": page.stat().st_size / 1e6,
        **{name: statistics.median(values) for name, values in times.items()},
        **{f"longest_{name}": max(values) for name, values in times.items()},
    }


def photograph(page: Path) -> None:
    """Write `page.png`, a picture of a page of `lfref view` after a tap."""
    with chromium() as browser:
        size = dict(zip(("width", "height"), WINDOW, strict=True))
        tab = opened(browser, page, viewport=size, device_scale_factor=PIXELS_WIDE / WINDOW[0])
        box = tab.evaluate("() => currentBox()")
        tab.mouse.click(box["left"] + TAP[0] * box["width"], box["top"] + TAP[1] * box["height"])
        tab.wait_for_timeout(50)
        tab.wait_for_function(RESTS)
        tab.wait_for_timeout(1500)  # until the ring and the text are gone
        tab.screenshot(path=RUN / "page.png")


def picture() -> Figure:
    """The picture of the page, in its own pixels."""
    pixels = images.read_image(RUN / "page.png")[..., :3]
    height, width = (side / drawing.PNG["dpi"] for side in pixels.shape[:2])
    figure = drawing.new_figure(width, height)
    figure.set_dpi(drawing.PNG["dpi"])
    figure.set_layout_engine("none")
    figure.figimage(pixels)
    return figure


def browsing() -> Iterator[str]:
    """Times to the first picture, to the lens, and to follow a slider."""
    figures = json.loads((RUN / "browsing.json").read_text())
    texts = {name: f"{value:.0f} ms" for name, value in figures.items() if name.endswith("_ms")}
    yield f"A page of {figures['megabytes']:.1f} MB ({GRID[0]}x{GRID[1]} views of {SIZE[0]}x{SIZE[1]} pixels) shows"
    yield f"its first picture {texts['paint_ms']} after it is opened from disk (median of {LOADS}; the longest"
    yield f"{texts['longest_paint_ms']}) and draws by its lens after {texts['ready_ms']} ({texts['longest_ready_ms']})."
    yield f"After {N_EVENTS} events of a slider, the last one is drawn within {texts['following_ms']}"
    yield f"({texts['longest_following_ms']}). Chromium {figures['version']}, without a graphics processor."


PICTURES: dict[str, Callable[[], Figure]] = {"page.jpg": picture} if (RUN / "page.png").is_file() else {}
IS_MEASURED = (RUN / "browsing.json").is_file()
TABLES: dict[str, Callable[[], Iterator[str]]] = {"browsing": browsing} if IS_MEASURED else {}


def main() -> None:
    """Write pages, open them, and write `browsing.json` and `page.png`."""
    lfref = [sys.executable, "-m", "lfref.cli.main"]
    with tempfile.TemporaryDirectory() as name:
        camera = [f"scene.camera.grid=[{GRID[0]},{GRID[1]}]", f"scene.camera.size=[{SIZE[0]},{SIZE[1]}]"]
        words = ("n_fields=1", *camera, "outputs=[views]")
        subprocess.run([*lfref, "simulate", f"output={name}/scene", *words], check=True)
        (scene,) = Path(name, "scene").glob("simulated_*")
        subprocess.run([*lfref, "view", str(scene), f"output={name}/view"], check=True)
        figures = measure(Path(name, "view", "index.html"))
        RUN.mkdir(parents=True, exist_ok=True)
        words = ("scene=sim30", f"scene.name={SCENE}", "outputs=[views]", f"output={name}/thicket")
        subprocess.run([*lfref, "simulate", *words], check=True)
        subprocess.run([*lfref, "view", f"{name}/thicket/{SCENE}", f"output={name}/page"], check=True)
        photograph(Path(name, "page", "index.html"))
    (RUN / "browsing.json").write_text(json.dumps(figures, indent=1))
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
