"""The scene that opens the site: its page by `lfref view`, which visitors refocus, and the site's card.

`living.py` writes both to `runs/living`, unless they are newer than the viewer, the scene and this file; the
build of the site does the same. `--film` also films the page in use, in Chromium, for the README:
`docs/pictures/page.webp`. The scene is simulated, `conf/scene/evening`: lamps far away, fruit on a table, leaves and
twigs near the camera. It is part of lfref and has its licence.
"""

import argparse
import io
import shutil
import subprocess
import sys
from pathlib import Path

from hydra import compose, initialize_config_dir
from PIL import Image, ImageDraw
from torch import Tensor
from torch.nn import functional as F

import lfref
from lfref.cli import config as configs
from lfref.io import images
from lfref.refocus import apertures
from lfref.report import pictures
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import finer

ROOT = Path(__file__).resolve().parents[1]
RUN = ROOT / "runs" / "living"
PAGE, CARD = RUN / "view" / "index.html", RUN / "card.jpg"
SCENE = configs.directory() / "scene" / "evening.yaml"
FAR, FRUIT, NEAR = -2.0, 0.1, 1.0
"""Slopes at which the lamps, the fruit and the leaves are sharp."""
CARD_SIZE = (630, 1200)
"""Height and width that Open Graph and Twitter's large card have in common."""
FILM, WINDOW = ROOT / "docs" / "pictures" / "page.webp", (1000, 600)
GRAPHICS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Graphics by the processor, where there is no other."""
CLICKS = ((0.131, 0.2), (0.152, 0.68), (0.55, 0.70), (0.86, 0.20))
"""Points of the picture that are clicked in turn, shares of its width and height: a lamp, a leaf, the fruit, a leaf."""
POINTING_MS, HELD_MS, MOVING_MS, N_MOVING, RING = 500, 1300, 80, 6, 11
"""Milliseconds that the ring shows where the click will be, that a focus stays, and of each frame between."""


def evening() -> Scene:
    """The scene `conf/scene/evening` with twice the pixels: its disparities are twice as large."""
    camera = ["scene.camera.size=[200,320]", "scene.camera.samples=2", "scene.camera.aperture=disc"]
    with initialize_config_dir(str(configs.directory()), version_base="1.3"):
        return finer(configs.build(compose("simulate", ["scene=evening", *camera]).scene), 2)


def make() -> None:
    """Write the page and the card, unless they are newer than the viewer, the scene and this file."""
    sources = [Path(__file__), SCENE, *(ROOT / "lfref" / "viewer").iterdir()]
    if all(made.is_file() and made.stat().st_mtime > max(map(_written, sources)) for made in (PAGE, CARD)):
        return
    field = lfref.LightField(lfref.simulate(evening(), outputs=("views",)).views)
    RUN.mkdir(parents=True, exist_ok=True)
    lfref.write(RUN / "evening.exr", field)
    words = ["aperture=disc", "method@methods.first=occlusion_aware"]
    planes = ["planes=even", f"planes.first={FAR}", f"planes.last={NEAR}", "planes.n=13"]
    # At the 42 dB of other pages it would have 10 MB, not 3.5; the pictures at rest have that all the same.
    planes.append("page_quality.least_db=36")
    command = [sys.executable, "-m", "lfref.cli.main", "view", str(RUN / "evening.exr"), *words, *planes]
    subprocess.run([*command, "title=An evening", f"output={PAGE.parent}", "overwrite=true"], check=True, cwd=ROOT)
    images.write_image(CARD, pictures.for_display(_card(field.views)), quality=88)


def _card(views: Tensor) -> Tensor:
    """The scene focused on the fruit, [C, H, W], cut and enlarged to the card's size."""
    focused = lfref.occlusion_aware(views, [FRUIT], weights=apertures.disc((7, 7)))[0]
    height = focused.shape[-1] * CARD_SIZE[0] // CARD_SIZE[1]
    top = (focused.shape[-2] - height) // 2
    window = focused[None, :, top : top + height]
    return F.interpolate(window, CARD_SIZE, mode="bicubic", antialias=True)[0].clamp(min=0)


def film() -> None:
    """Write the film of the page: points are ringed and clicked in turn."""
    from playwright.sync_api import sync_playwright  # only who films needs it

    frames: list[Image.Image] = []
    times: list[int] = []
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=GRAPHICS)
        tab = browser.new_page(viewport={"width": WINDOW[0], "height": WINDOW[1]}, reduced_motion="no-preference")
        tab.goto(PAGE.as_uri())
        tab.wait_for_function("() => drawing !== null && !motion && stage.dataset.rests === 'true'")
        box = tab.evaluate("() => currentBox()")
        box = {"x": box["left"], "y": box["top"], "width": box["width"], "height": box["height"]}

        def take(duration: int) -> Image.Image:
            frames.append(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))
            times.append(duration)
            return frames[-1]

        for across, down in CLICKS:
            x, y = box["x"] + across * box["width"], box["y"] + down * box["height"]
            ends = [x - RING, y - RING, x + RING, y + RING]
            ImageDraw.Draw(take(POINTING_MS)).ellipse(ends, outline="white", width=3)
            tab.mouse.click(x, y)
            for _ in range(N_MOVING):
                tab.wait_for_timeout(MOVING_MS)
                take(MOVING_MS)
            take(HELD_MS)
        browser.close()
    frames[0].save(FILM, save_all=True, append_images=frames[1:], duration=times, loop=0, quality=70, method=6)


def _written(path: Path) -> float:
    return path.stat().st_mtime


def main() -> None:
    """Write what is missing, and the film on request."""
    parser = argparse.ArgumentParser(description="Make the page that opens the site, and the site's card.")
    parser.add_argument("--film", action="store_true", help=f"also film the page: {FILM.relative_to(ROOT)}")
    make()
    if parser.parse_args().film:
        film()
    print(f"{PAGE}, {CARD}")


if __name__ == "__main__":
    main()
