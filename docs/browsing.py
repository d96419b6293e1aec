"""The page of `lfref view`: how soon it shows a picture, how fast it follows, how good its lens is, what it looks like.

`python docs/browsing.py` leaves `runs/figures/browsing/browsing.json`, from which `docs/measure.py browsing lens` makes
a paragraph and a table, and `page.png`, from which `docs/pictures.py page.jpg` makes a picture.
"""

import json
import math
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import experiments
import torch
from matplotlib.figure import Figure

from lfref import encoding
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.io import images
from lfref.refocus.shift.shift_and_sum import shift_and_sum, shift_and_sum_through_cells
from lfref.report import drawing
from lfref.report.refocused import Refocused
from lfref.viewer import view_page
from lfref.viewer.coding import ViewQuality

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "browsing"
SCENE, TAP = "thicket", (0.535, 0.57)
"""Scene of the picture of the page, and the point that is tapped, on a twig: shares of width and height."""
WINDOW, PIXELS_WIDE = (1100, 755), 900
"""Size of the window, and width of the picture, in pixels."""
GRID, SIZE, LOADS, N_EVENTS = (9, 9), (375, 540), 7, 20
VIEWPORT = {"width": 1280, "height": 900}
UNTOUCHED_MS = 2000
"""Milliseconds in which a page has painted its first picture."""
QUALITY_SCENES, QUALITY_SLOPES, MARGIN = ("thicket", "twigs", "apple"), (-7.0, -3.0, -1.0, 0.2, 0.5, 1.0), 12
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
PICTURE = """(slope) => {
  drawing.draw({ ...WHOLE, slope });
  const read = drawing.pixels();
  return [read.height, read.width, Array.from(read.data)];
}"""


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


def qualities() -> list[dict[str, Any]]:
    """PSNR against the truth, scene by scene and slope by slope, of the page's lens and of our operators."""
    planes, rows = FocalPlanes(QUALITY_SLOPES), []
    with chromium() as browser, tempfile.TemporaryDirectory() as name:
        for case in experiments.cases(QUALITY_SCENES, planes):
            plain, cells = (
                operator(case.light.views, planes.slopes) for operator in (shift_and_sum, shift_and_sum_through_cells)
            )
            shown = Refocused(case.light, cells, planes)
            of_8_bits = shift_and_sum_through_cells(_in_8_bits(case.light.views), planes.slopes)
            stacks = {
                "shift_and_sum": plain,
                "shift_and_sum_through_cells": cells,
                "the same, of 8 bits": _in_8_bits(of_8_bits),
            }
            for title, quality in {"page": None, "page, without loss": ViewQuality(math.inf, None)}.items():
                page = Path(name, "index.html")
                view_page.write(page, "quality", {}, view_page.page_content({"cells": shown}, quality=quality))
                tab = opened(browser, page)
                stacks[title] = torch.stack([_light(tab.evaluate(PICTURE, slope)) for slope in QUALITY_SLOPES])
                tab.context.close()
            inner = (..., slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
            for method, stack in stacks.items():
                values = psnr(stack[inner].double(), case.reference[inner].double())
                rows += [
                    {"scene": case.light.name, "method": method, "slope": slope, "psnr_db": float(value)}
                    for slope, value in zip(QUALITY_SLOPES, values, strict=True)
                ]
    return rows


def _in_8_bits(light: torch.Tensor) -> torch.Tensor:
    """Light [..., H, W] as a screen shows it: between 0 and 1, in 8 bits of sRGB."""
    return encoding.SRGB.decode((255 * encoding.SRGB.encode(light.clamp(0, 1))).round() / 255)


def _light(read: tuple[int, int, list[int]]) -> torch.Tensor:
    """Pixels of the page as linear light, [3, H, W]."""
    height, width, values = read
    pixels = torch.tensor(values, dtype=torch.uint8).reshape(height, width, 4)[..., :3].permute(2, 0, 1)
    return torch.from_numpy(images.decoded(pixels.numpy(), encoding.SRGB))


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


def lens() -> Iterator[str]:
    """Quality of the page's lens beside that of our operators."""
    rows = json.loads((RUN / "browsing.json").read_text())["lens"]
    yield "| scene, PSNR in dB | " + " | ".join(f"slope {slope:g}" for slope in QUALITY_SLOPES) + " |"
    yield "|---" * (len(QUALITY_SLOPES) + 1) + "|"
    for scene in dict.fromkeys(row["scene"] for row in rows):
        for method in dict.fromkeys(row["method"] for row in rows):
            values = [row["psnr_db"] for row in rows if (row["scene"], row["method"]) == (scene, method)]
            yield f"| {scene}, {method} | " + " | ".join(f"{value:.1f}" for value in values) + " |"


PICTURES: dict[str, Callable[[], Figure]] = {"page.jpg": picture} if (RUN / "page.png").is_file() else {}
IS_MEASURED = (RUN / "browsing.json").is_file()
TABLES: dict[str, Callable[[], Iterator[str]]] = {"browsing": browsing, "lens": lens} if IS_MEASURED else {}


def main() -> None:
    """Write pages, open them, and write `browsing.json` and `page.png`."""
    lfref = [sys.executable, "-m", "lfref.cli.main"]
    with tempfile.TemporaryDirectory() as name:
        camera = [f"scene.camera.grid=[{GRID[0]},{GRID[1]}]", f"scene.camera.size=[{SIZE[0]},{SIZE[1]}]"]
        words = ("n_fields=1", *camera, "outputs=[views]")
        subprocess.run([*lfref, "simulate", f"output={name}/scene", *words], check=True)
        (scene,) = Path(name, "scene").glob("simulated_*")
        subprocess.run([*lfref, "view", str(scene), f"output={name}/view"], check=True)
        figures = measure(Path(name, "view", "index.html")) | {"lens": qualities()}
        RUN.mkdir(parents=True, exist_ok=True)
        words = ("scene=sim30", f"scene.name={SCENE}", "outputs=[views]", f"output={name}/thicket")
        subprocess.run([*lfref, "simulate", *words], check=True)
        subprocess.run([*lfref, "view", f"{name}/thicket/{SCENE}", f"output={name}/page"], check=True)
        photograph(Path(name, "page", "index.html"))
    (RUN / "browsing.json").write_text(json.dumps(figures, indent=1))
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
