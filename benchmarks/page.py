"""The page of `lfref view`: the one that opens the site, its film and picture, how soon it shows, how fast it follows.

`page.py` writes the page and the card of the site to `runs/living`, unless they are newer than the viewer, the scene
and this file; the build of the site does the same. `--film` also films the page in use, in Chromium, for the README,
photographs one, and measures times, which `figures.py browsing` puts into the page on viewing. The scene is simulated,
`conf/scene/evening`: lamps far away, fruit on a table, leaves and twigs near the camera. It is part of lfref and has
its licence.
"""

import argparse
import io
import json
import shutil
import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pages
from PIL import Image, ImageDraw
from torch.nn import functional as F

import lfref
from lfref.bench import timing
from lfref.cli import config as configs
from lfref.encoding import SRGB
from lfref.io import images
from lfref.io.read import SAMPLE
from lfref.refocus import apertures
from lfref.report import pictures
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import finer

RUN = pages.ROOT / "runs" / "living"
PAGE, CARD = RUN / "view" / "index.html", RUN / "card.jpg"
SCENE = configs.directory() / "scene" / "evening.yaml"
FAR, FRUIT, NEAR = -2.0, 0.1, 1.0
"""Slopes at which the lamps, the fruit and the leaves are sharp."""
CARD_SIZE = (630, 1200)
"""Height and width that Open Graph and Twitter's large card have in common."""
FILM, WINDOW = pages.PICTURES / "page.webp", (960, 600)
CLICKS = ((0.131, 0.2), (0.152, 0.68), (0.55, 0.70), (0.86, 0.20))
"""Points of the picture that are clicked in turn, shares of its width and height: a lamp, a leaf, the fruit, a leaf."""
POINTING_MS, HELD_MS, MOVING_MS, N_MOVING, RING = 500, 1300, 80, 6, 11
"""Milliseconds that the ring shows where the click will be, that a focus stays, and of each frame between."""
SETTLING_MS = 1500
"""Milliseconds until the page has hidden its ring and text, and shows its best picture."""
PHOTOGRAPHED, TAP = "thicket", (0.535, 0.57)
"""Scene of sim30 in the picture of a page, and the point that is tapped, on a twig."""
SAMPLE_QUALITY = 93
"""Quality of the JPEG files of the sample: 1.9 MB; `blockwise_wiener` has 51 dB against the truth with them."""
MEASURES = pages.FIGURES / "browsing.json"
GRID, LOADS, N_EVENTS = (9, 9), 7, 20
UNTOUCHED_MS = 2000
"""Milliseconds in which a page has painted its first picture."""
FIRST_PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"
RESTS = "() => drawing !== null && stage.dataset.rests === 'true' && !motion && !isRequested && drawing.took() !== null"
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
SLIDE = """(value) => {
  find("focus").value = value;
  find("focus").dispatchEvent(new Event("input"));
}"""


def evening() -> Scene:
    """The scene `conf/scene/evening` with twice the pixels: its disparities are twice as large."""
    camera = ["scene.camera.size=[200,320]", "scene.camera.samples=2", "scene.camera.aperture=disc"]
    return finer(configs.build(pages.composed("simulate", "scene=evening", *camera).scene), 2)


def make() -> None:
    """Write the page and the card, unless they are newer than the viewer, the scene and this file."""
    sources = [Path(__file__), SCENE, *(pages.ROOT / "lfref" / "viewer").iterdir()]
    newest = max(path.stat().st_mtime for path in sources)
    if all(made.is_file() and made.stat().st_mtime > newest for made in (PAGE, CARD)):
        return
    field = lfref.LightField(lfref.simulate(evening(), outputs=("views",)).views)
    RUN.mkdir(parents=True, exist_ok=True)
    lfref.write(RUN / "evening.exr", field, overwrite=True)
    words = ["aperture=disc", "method@methods.first=blockwise_wiener", "title=An evening"]
    words += ["planes=even", f"planes.first={FAR}", f"planes.last={NEAR}", "planes.n=13"]
    # At the 42 dB of other pages it would have 10 MB, not 3.5; the pictures at rest have that all the same.
    words.append("page_quality.least_db=36")
    pages.lfref("view", RUN / "evening.exr", *words, f"output={PAGE.parent}", "overwrite=true")
    # The card is the scene focused on the fruit, cut and enlarged.
    focused = lfref.blockwise_wiener(field.views, [FRUIT], weights=apertures.disc((7, 7)))[0]
    height = focused.shape[-1] * CARD_SIZE[0] // CARD_SIZE[1]
    top = (focused.shape[-2] - height) // 2
    window = focused[None, :, top : top + height]
    card = F.interpolate(window, CARD_SIZE, mode="bicubic", antialias=True)[0].clamp(min=0)
    images.write_image(CARD, pictures.for_display(card), quality=88)


def make_gallery() -> None:
    """Write pages of the path-traced scenes that are rendered, for the site."""
    import judges  # Mitsuba is needed by nothing else here

    for name in judges.complete():
        lfref.write(RUN / f"{name}.exr", lfref.LightField(judges.judged(name)[0]), overwrite=True)
        words = ("method@methods.first=blockwise_wiener", f"title={name}", f"output={RUN / name}", "overwrite=true")
        pages.lfref("view", RUN / f"{name}.exr", *words)


@contextmanager
def chromium() -> Iterator[Any]:
    """The Chromium that is installed, with graphics by the processor where there is no other."""
    from playwright.sync_api import sync_playwright  # only who measures needs it

    graphics = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=graphics)
        yield browser
        browser.close()


def opened(browser: Any, page: Path, size: tuple[int, int], waits_ms: int = 0, **options: Any) -> Any:
    """A page in a window of a size, whose lens is ready and rests; nothing asks it before some time has passed."""
    viewport = dict(zip(("width", "height"), size, strict=True))
    tab = browser.new_context(viewport=viewport, **{"reduced_motion": "reduce"} | options).new_page()
    tab.goto(page.as_uri())
    tab.wait_for_timeout(waits_ms)
    tab.wait_for_function(RESTS)
    return tab


def places(tab: Any, *points: tuple[float, float]) -> list[tuple[float, float]]:
    """Pixels of the window at points of the picture, shares of its width and height."""
    box = tab.evaluate("() => currentBox()")
    return [(box["left"] + x * box["width"], box["top"] + y * box["height"]) for x, y in points]


def film() -> None:
    """Write the film of the page: points are ringed and clicked in turn; each frame waits until the page rests."""
    frames: list[Image.Image] = []
    times: list[int] = []
    with chromium() as browser:
        tab = opened(browser, PAGE, WINDOW)

        def take(duration: int) -> Image.Image:
            frames.append(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))
            times.append(duration)
            return frames[-1]

        for x, y in places(tab, *CLICKS):
            ends = [x - RING, y - RING, x + RING, y + RING]
            ImageDraw.Draw(take(POINTING_MS)).ellipse(ends, outline="white", width=3)
            start = tab.evaluate("find('focus').value")
            tab.mouse.click(x, y)
            tab.wait_for_timeout(50)
            tab.wait_for_function(RESTS)
            end = tab.evaluate("find('focus').value")
            for value in np.linspace(float(start), float(end), N_MOVING + 1)[1:]:
                tab.evaluate(SLIDE, str(value))
                tab.wait_for_function(RESTS)
                take(MOVING_MS)
            tab.wait_for_timeout(SETTLING_MS)
            take(HELD_MS)
    frames[0].save(FILM, save_all=True, append_images=frames[1:], duration=times, loop=0, quality=70, method=6)


def photograph(page: Path) -> None:
    """Write `page.jpg`, a page of `lfref view` after a tap, 900 pixels wide."""
    with chromium() as browser:
        tab = opened(browser, page, (1100, 755), device_scale_factor=900 / 1100)
        tab.mouse.click(*places(tab, TAP)[0])
        tab.wait_for_timeout(50)
        tab.wait_for_function(RESTS)
        tab.wait_for_timeout(1500)  # until the ring and the text are gone
        tab.screenshot(path=pages.PICTURES / "page.jpg", type="jpeg", quality=83)


def measure(page: Path) -> dict[str, Any]:
    """Milliseconds that a page takes to its first picture, to its lens, and to follow a slider; medians and longest."""
    times: dict[str, list[float]] = {"paint": [], "ready": [], "following": []}
    with chromium() as browser:
        for _ in range(LOADS):
            # Nothing asks the page before it has painted: questions take time on the thread that paints.
            tab = opened(browser, page, (1280, 900), UNTOUCHED_MS)
            times["paint"].append(tab.evaluate(FIRST_PAINT))
            times["ready"].append(tab.evaluate("() => readyAt"))
            times["following"].append(tab.evaluate(EVENTS, N_EVENTS))
            tab.context.close()
        version = browser.version
    facts = timing.facts(pages.CPU) | {"version": version, "megabytes": page.stat().st_size / 1e6}
    return facts | {name: (statistics.median(values), max(values)) for name, values in times.items()}


def browsing() -> Iterator[str]:
    """Times to the first picture, to the lens, and to follow a slider."""
    figures = json.loads(MEASURES.read_text())
    paint, ready, following = (figures[name] for name in ("paint", "ready", "following"))
    size = f"{GRID[0]}x{GRID[1]} views of {pages.SIZE[0]}x{pages.SIZE[1]} pixels"
    yield f"A page of {figures['megabytes']:.1f} MB ({size}) shows its first"
    yield f"picture {paint[0]:.0f} ms after it is opened from disk (median of {LOADS}; the longest"
    yield f"{paint[1]:.0f} ms) and draws by its lens after {ready[0]:.0f} ms ({ready[1]:.0f} ms)."
    yield f"After {N_EVENTS} events of a slider, the last one is drawn within {following[0]:.0f} ms"
    yield f"({following[1]:.0f} ms). Chromium {figures['version']}, without a graphics processor."


def write_sample() -> None:
    """Render the views of the scene and write them where `lfref view sample` finds them, as JPEG."""
    with tempfile.TemporaryDirectory() as name:
        pages.lfref("simulate", "scene=evening", "outputs=[views]", f"output={name}/scene")
        field = lfref.read(Path(name, "scene", "evening"))
    SAMPLE.mkdir(exist_ok=True)
    for v, u in np.ndindex(field.grid):
        picture = SRGB.encode(field.views[v, u]).permute(1, 2, 0).numpy()
        images.write_image(SAMPLE / f"evening_{v}_{u}.jpg", picture, quality=SAMPLE_QUALITY)


def main() -> None:
    """Write what is missing; on request also the film, the picture and the times."""
    parser = argparse.ArgumentParser(description="Make the page that opens the site, and the site's card.")
    parser.add_argument("--film", action="store_true", help="also film, photograph and time pages in Chromium")
    parser.add_argument("--sample", action="store_true", help="write the sample that ships with lfref")
    parser.add_argument("--gallery", action="store_true", help="write pages of the path-traced scenes")
    options = parser.parse_args()
    if options.sample or options.gallery:
        write_sample() if options.sample else make_gallery()
        return
    make()
    if not options.film:
        return
    film()
    with tempfile.TemporaryDirectory() as name:
        words = ("scene=sim30", f"scene.name={PHOTOGRAPHED}", "outputs=[views]", f"output={name}/scene")
        pages.lfref("simulate", *words)
        pages.lfref("view", f"{name}/scene/{PHOTOGRAPHED}", f"output={name}/page")
        photograph(Path(name, "page", "index.html"))
        camera = [f"scene.camera.grid={[*GRID]}", f"scene.camera.size={[*pages.SIZE]}"]
        pages.lfref("simulate", "n_fields=1", *camera, "outputs=[views]", f"output={name}/large")
        pages.lfref("view", f"{name}/large/simulated_s0_e0_000", f"output={name}/timed")
        MEASURES.parent.mkdir(parents=True, exist_ok=True)
        MEASURES.write_text(json.dumps(measure(Path(name, "timed", "index.html")), indent=1))


if __name__ == "__main__":
    main()
