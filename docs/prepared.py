"""Prepared sets of captures: how fast they are made, and how fast a training over many of them starts.

`python docs/prepared.py` makes ESLF images of a Lytro's size from a simulated scene, prepares them, and starts over a
set of as many light fields as the paper trains on; it leaves `runs/figures/prepared/prepared.json`, from which
`docs/measure.py prepared` makes the table of the page on scaling.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import torch

from lfref.bench import timing
from lfref.data import prepared
from lfref.io import images
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.simulate import simulate

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "prepared"
LENSLETS, VIEWS = (375, 540), 14
N_FILES, N_FIELDS = 24, 3343
"""Images that are prepared; light fields of the paper, over which a training starts."""
START = """
import sys, time
from lfref.data.datamodules import FolderData
from lfref.data.label_sources import RenderedLabels
from lfref.geometry import planes_at_alphas
start = time.perf_counter()
labels = RenderedLabels("none", planes_at_alphas((1.0,)))
reader = {reader!r}
data = FolderData(sys.argv[1], labels, sys.argv[2], reader=reader)
data.prepare_data()
data.setup("fit")
assert len(data.train) > 3000
print(time.perf_counter() - start)
"""


def draw_images(folder: Path) -> int:
    """Write ESLF images of 16 bits, and return the size of one in bytes."""
    scene = RandomScenes(Camera((VIEWS, VIEWS), LENSLETS)).scene(0, 0, 0)
    views = simulate(scene, outputs=("views",)).views.clamp(0, 1)
    noise = 0.01 * torch.randn(views.shape, generator=torch.Generator().manual_seed(0))
    image = (views + noise).clamp(0, 1).permute(3, 0, 4, 1, 2).reshape(LENSLETS[0] * VIEWS, LENSLETS[1] * VIEWS, 3)
    folder.mkdir()
    first = folder / "IMG_0_eslf.png"
    images.write_image(first, image.numpy(), bits=16)
    for index in range(1, N_FILES):
        os.link(first, folder / f"IMG_{index}_eslf.png")
    return first.stat().st_size


def fields_per_second(files: Path, folder: Path) -> float:
    """Light fields that `lfref prepare` decodes per second, with all processors, from shell to set."""
    words = ("prepare", files, "set=captures", f"set_folder={folder / 'set'}", f"output={folder / 'run'}")
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "lfref.cli.main", *map(str, words)], check=True, stdout=subprocess.DEVNULL)
    return N_FILES / (time.perf_counter() - start)


def start_seconds(folder: Path) -> float:
    """Seconds in which a training knows its fields, those of a set as large as the paper's, in a new process."""
    first = prepared.manifest(folder / "set")[0]
    for index in range(N_FIELDS):
        link = folder / "many" / f"field_{index:04d}.field"
        link.parent.mkdir(exist_ok=True)
        os.link(folder / "set" / first.file, link)
    prepared.write_manifest(folder / "many")
    # Links are one light field; a data set has different ones.
    manifest = folder / "many" / prepared.MANIFEST
    contents = json.loads(manifest.read_text())
    fields = [entry | {"content": f"{index}"} for index, entry in enumerate(contents["fields"])]
    manifest.write_text(json.dumps(contents | {"fields": fields}))
    code = START.format(reader=dict(first.reading["reader"]))
    words = [sys.executable, "-c", code, str(folder / "many"), str(folder / "cache")]
    return min(float(subprocess.run(words, check=True, capture_output=True, text=True).stdout) for _ in range(3))


def table() -> Iterator[str]:
    """Rates of preparing and starting."""
    figures = json.loads((RUN / "prepared.json").read_text())
    yield "| figure | measured |"
    yield "|---|---|"
    yield f"| preparing, light fields a second | {figures['fields_per_s']:.2f} |"
    yield f"| one light field, MB: the image, prepared | {figures['image_mb']:.0f}, {figures['field_mb']:.1f} |"
    yield f"| start over {N_FIELDS:,} prepared light fields, s | {figures['start_s']:.2f} |"
    yield ""
    size = f"{LENSLETS[0] * VIEWS}x{LENSLETS[1] * VIEWS}"
    yield f"{N_FILES} ESLF images of 16 bits, {size} pixels, 7x7 views of them kept;"
    yield f"{figures['cores']} cores, {figures['processor']}. `python docs/prepared.py`"


TABLES: dict[str, Callable[[], Iterator[str]]] = {"prepared": table} if (RUN / "prepared.json").is_file() else {}


def main() -> None:
    """Measure, and write `prepared.json`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image_bytes = draw_images(folder / "files")
        rate = fields_per_second(folder / "files", folder)
        field_bytes = prepared.manifest(folder / "set")[0].n_bytes
        figures = {"fields_per_s": rate, "image_mb": image_bytes / 1e6, "field_mb": field_bytes / 1e6}
        figures["start_s"] = start_seconds(folder)
    facts = timing.facts(torch.device("cpu"))
    RUN.mkdir(parents=True, exist_ok=True)
    figures |= {"cores": len(os.sched_getaffinity(0)), "processor": facts["processor"]}
    (RUN / "prepared.json").write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
