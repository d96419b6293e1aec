"""The page of `lfref view`: how soon it shows its first picture and another plane, and what it looks like.

`python docs/browsing.py` leaves `runs/figures/browsing/browsing.json`, from which `docs/measure.py browsing` makes a
paragraph, and `page.png`, from which `docs/pictures.py page.jpg` makes a picture.
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
SCENE, CLICK = "thicket", (0.535, 0.57)
"""Scene of the picture of the page, and the point that is clicked, on a twig: shares of width and height."""
WINDOW, PIXELS_WIDE = (1100, 755), 900
"""Size of the window, and width of the picture, in pixels."""
SIZE, N_PLANES, LOADS, ROUNDS = (375, 540), 16, 7, 3
FIRST_PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"
SWITCH = """async (plane) => {
  const slider = document.getElementById("plane"), start = performance.now();
  slider.value = plane;
  state.plane = plane;
  await show();
  document.getElementById("flat").getContext("2d").getImageData(0, 0, WIDTH, HEIGHT);
  return performance.now() - start;
}"""
"""Until the plane is drawn: its pixels are read, which waits for that and takes time itself."""


@contextmanager
def chromium() -> Iterator[Any]:
    """The Chromium that is installed."""
    from playwright.sync_api import sync_playwright  # only who measures needs it

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        yield browser
        browser.close()


def measure(page: Path) -> dict[str, float]:
    """Milliseconds that a page of `lfref view` takes to its first picture, and to another plane."""
    with chromium() as browser:
        paints, switches, first = [], [], []
        for _ in range(LOADS):
            tab = browser.new_context(viewport={"width": 1280, "height": 900}).new_page()
            tab.goto(page.as_uri())
            tab.wait_for_selector("#stage[data-drawn=planes]")
            paints.append(tab.evaluate(FIRST_PAINT))
            times = [tab.evaluate(SWITCH, plane) for _ in range(ROUNDS) for plane in range(N_PLANES)]
            first.append(max(times[:N_PLANES]))
            switches += times[N_PLANES:]
            tab.context.close()
        version = browser.version
    return {
        "version": version,
        "megabytes": page.stat().st_size / 1e6,
        "paint_ms": statistics.median(paints),
        "longest_paint_ms": max(paints),
        "switch_ms": statistics.median(switches),
        "longest_switch_ms": max(switches),
        "longest_first_switch_ms": max(first),
    }


def photograph(page: Path) -> None:
    """Write `page.png`, a picture of a page of `lfref view` after a click."""
    with chromium() as browser:
        size = dict(zip(("width", "height"), WINDOW, strict=True))
        tab = browser.new_context(viewport=size, device_scale_factor=PIXELS_WIDE / WINDOW[0]).new_page()
        tab.goto(page.as_uri())
        stage = tab.wait_for_selector("#stage[data-drawn=planes]")
        box = stage.bounding_box()
        tab.mouse.click(box["x"] + CLICK[0] * box["width"], box["y"] + CLICK[1] * box["height"])
        tab.wait_for_timeout(500)  # until it is drawn
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
    """Times to the first picture and to another plane."""
    figures = json.loads((RUN / "browsing.json").read_text())
    texts = {name: f"{value:.0f} ms" for name, value in figures.items() if name.endswith("_ms")}
    yield f"A page of {figures['megabytes']:.1f} MB (7x7 views of {SIZE[0]}x{SIZE[1]} pixels, {N_PLANES} planes, two"
    yield f"methods) shows its first picture {texts['paint_ms']} after it is opened from disk (median of {LOADS}; the"
    yield f"longest {texts['longest_paint_ms']}), and another plane in {figures['switch_ms']:.1f} ms (the longest"
    yield f"{texts['longest_switch_ms']}; {texts['longest_first_switch_ms']} when planes are shown for the first time)."
    yield f"Chromium {figures['version']}, without a graphics processor."


PICTURES: dict[str, Callable[[], Figure]] = {"page.jpg": picture} if (RUN / "page.png").is_file() else {}
IS_MEASURED = (RUN / "browsing.json").is_file()
TABLES: dict[str, Callable[[], Iterator[str]]] = {"browsing": browsing} if IS_MEASURED else {}


def main() -> None:
    """Write pages, open them, and write `browsing.json` and `page.png`."""
    lfref = [sys.executable, "-m", "lfref.cli.main"]
    with tempfile.TemporaryDirectory() as name:
        size = f"scene.camera.size=[{SIZE[0]},{SIZE[1]}]"
        subprocess.run([*lfref, "simulate", f"output={name}/scene", "n_fields=1", size, "outputs=[views]"], check=True)
        (scene,) = Path(name, "scene").glob("simulated_*")
        subprocess.run([*lfref, "view", str(scene), f"output={name}/view", f"planes.n={N_PLANES}"], check=True)
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
