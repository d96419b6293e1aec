"""The scene that opens the site: its page by `lfref view`, which visitors refocus, and the site's card.

`python docs/living.py` writes both to `runs/living`, unless they are newer than the viewer and this file; the build of
the site does the same. `--film` also films the page in use, in Chromium, for the README: `docs/pictures/page.webp`. The
scene is simulated: lamps far away, fruit on a table, leaves and twigs near the camera. It is part of lfref and has its
licence.
"""

import argparse
import io
import shutil
import subprocess
import sys
from pathlib import Path

from PIL import Image, ImageDraw
from torch import Tensor
from torch.nn import functional as F

import lfref
from lfref.io import images
from lfref.refocus import apertures
from lfref.report import pictures
from lfref.simulator.materials import Emissive, Glossy
from lfref.simulator.mattes import Disc, Leaf, Polygon, Twigs
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Gradient, Noise

ROOT = Path(__file__).resolve().parents[1]
RUN = ROOT / "runs" / "living"
PAGE, CARD = RUN / "view" / "index.html", RUN / "card.jpg"
SIZE = (320, 512)
FAR, FRUIT, NEAR = -2.0, 0.6, 1.6
"""Slopes at which the lamps, the fruit and the leaves are sharp."""
CARD_SIZE = (630, 1200)
"""Height and width that Open Graph and Twitter's large card have in common."""
FILM, WINDOW = ROOT / "docs" / "pictures" / "page.webp", (1000, 600)
GRAPHICS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Graphics by the processor, where there is no other."""
CLICKS = ((0.08, 0.23), (0.152, 0.68), (0.55, 0.70), (0.86, 0.20))
"""Points of the picture that are clicked in turn, shares of its width and height: a lamp, a leaf, the fruit, a leaf."""
POINTING_MS, HELD_MS, MOVING_MS, N_MOVING, RING = 500, 1300, 80, 6, 11
"""Milliseconds that the ring shows where the click will be, that a focus stays, and of each frame between."""

SKY = Gradient(900, (0.04, 0.07, 0.20), (0.75, 0.36, 0.22), angle=90, phase=0.05)
HILL = Noise((0.10, 0.13, 0.14), (0.07, 0.08, 0.07), exponent=1.3, hardness=0.3)
CLOTH = Checker(26, (0.55, 0.09, 0.08), (0.80, 0.76, 0.68), angle=18)
GREEN = Noise((0.20, 0.42, 0.14), (0.16, 0.20, 0.10), exponent=1.2, hardness=0.6)
RUST = Noise((0.55, 0.20, 0.07), (0.25, 0.14, 0.05), exponent=1.2, hardness=0.6)
APPLE = Noise((0.52, 0.07, 0.05), (0.16, 0.07, 0.03), exponent=1.0, hardness=0.4)
LEMON = Noise((0.52, 0.42, 0.05), (0.12, 0.11, 0.03), exponent=1.0, hardness=0.3)
BARK = Noise((0.30, 0.20, 0.13), (0.20, 0.14, 0.09), exponent=1.0, hardness=0.6)
HILLS = ((-400, 400), (-400, -5), (-230, -25), (-120, 5), (-30, -18), (90, 8), (190, -20), (400, -5), (400, 400))
TABLE_TOP = ((-420, 420), (-420, 46), (420, 46), (420, 420))
WARM, COLD, PINK = (1.0, 0.62, 0.24), (0.45, 0.72, 1.0), (1.0, 0.35, 0.45)
LAMPS = (
    (-215, -88, WARM),
    (-190, -20, WARM),
    (-168, -70, WARM),
    (-120, -60, PINK),
    (-70, -56, WARM),
    (-20, -58, COLD),
    (32, -66, WARM),
    (84, -80, WARM),
    (134, -98, PINK),
    (160, -22, WARM),
    (200, -34, COLD),
    (226, -60, WARM),
)


def evening() -> Scene:
    """The scene; what is farther comes first."""
    return Scene(
        Camera((7, 7), SIZE, aperture="disc"),
        (
            Surface(Plane(FAR), SKY),
            Surface(Plane(FAR + 0.05), HILL, Polygon(HILLS)),
            *(Surface(Plane(FAR + 0.1), Flat(colour), Disc(3.2, (x, y)), Emissive(7)) for x, y, colour in LAMPS),
            Surface(Plane(-0.55, (0.0, 0.0105)), CLOTH, Polygon(TABLE_TOP)),
            Surface(Dome(0.42, 0.3, 66, (12, 34)), APPLE, Disc(56, (12, 34)), Glossy(1.6, 8, 1.5, (-8, 14))),
            Surface(
                Dome(0.62, 0.25, 46, (98, 72)),
                LEMON,
                Disc(38, (98, 72)),
                Glossy(1.4, 6, 1.5, (86, 58)),
            ),
            Surface(Plane(0.75), BARK, Twigs(11, 2.5, 1, -70, (14, -14), seed=5)),
            Surface(Plane(1.5), BARK, Twigs(104, 4, 6, -62, (-236, 172), seed=3)),
            Surface(Plane(1.55), BARK, Twigs(86, 3.5, 6, 120, (262, -172), seed=8)),
            Surface(Plane(NEAR), RUST, Leaf(96, 32, 20, (-196, 112))),
            Surface(Plane(NEAR + 0.05), RUST, Leaf(90, 30, -150, (222, -20))),
            Surface(Plane(NEAR + 0.1), GREEN, Leaf(120, 40, -38, (-178, 58))),
            Surface(Plane(NEAR + 0.25), GREEN, Leaf(130, 44, -112, (196, -96))),
        ),
        Light(1.0, (1.0, 0.93, 0.85)),
        name="evening",
    )


def make() -> None:
    """Write the page and the card, unless they are newer than the viewer and this file."""
    sources = [Path(__file__), *(ROOT / "lfref" / "viewer").iterdir()]
    if all(made.is_file() and made.stat().st_mtime > max(map(_written, sources)) for made in (PAGE, CARD)):
        return
    field = lfref.LightField(lfref.simulate(evening(), outputs=("views",)).views)
    RUN.mkdir(parents=True, exist_ok=True)
    lfref.write(RUN / "evening.exr", field)  # EXR keeps light that is brighter than white
    words = ["aperture=disc", "method@methods.first=occlusion_aware"]
    planes = ["planes=even", f"planes.first={FAR}", "planes.last=1.8", "planes.n=13"]
    # Its saturated lamps take most of the bytes at 42 dB; the pictures at rest have that all the same.
    planes.append("views.least_db=36")
    command = [sys.executable, "-m", "lfref.cli.main", "view", str(RUN / "evening.exr"), *words, *planes]
    subprocess.run([*command, "title=An evening", f"output={PAGE.parent}", "overwrite=true"], check=True, cwd=ROOT)
    images.write_image(CARD, pictures.for_display(_card(field.views)), quality=88)


def _card(views: Tensor) -> Tensor:
    """The scene focused on the fruit, [C, H, W], cut and enlarged to the card's size."""
    focused = lfref.occlusion_aware(views, [FRUIT], weights=apertures.disc((7, 7)))[0]
    height = SIZE[1] * CARD_SIZE[0] // CARD_SIZE[1]
    top = (SIZE[0] - height) // 2
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
