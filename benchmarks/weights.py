"""Put the RefNet of a training run into the package, with how it was made: `python benchmarks/weights.py RUN`.

Run by `make weights`. Fills the accuracy in the pages. Without RUN the network that ships is measured again.
"""

import argparse
import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path

import pages
import paper
import torch
from pages import CPU, PLANES

import lfref
from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import IDEAL, EvaluationCase, ideal_case
from lfref.io import images
from lfref.io.read import read
from lfref.io.run import Run
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import networks
from lfref.report import pictures
from lfref.simulator import sim30

PLACES = ("output=", "data.cache_folder=", "data.workers=", "resume=", "callbacks.", "+trainer.enable_")
"""Overrides that no notes tell: where a run lies on a disk is nobody's concern."""
LARGE = 100_000
"""Numbers in a weight from which RefNet's are stored in half precision; the head's fix the colours of dark captures."""
SHOWN = [0, 1, 2, 3, 5, 7, 11, 15]
"""Planes of the capture that the page shows."""
REFNET_CARD = {
    "use": "refocuses 7x7 views to the paper's 16 planes (alpha .125 to 2) in one pass; other grids and planes need a "
    "training of their own, which may start from it",
    "data": "scenes of lfref's simulator, drawn at random, with noise; labels by linear shift-and-sum; no photographs",
    "trained_on": "7x7 views of three channels of linear light, disparities of up to 1 px per view step",
    "limits": "imitates linear shift-and-sum and is at best as good as it, copies of edges in wide blur included; "
    "least accurate at alpha .125 and .25, and at the border of the frame",
    "licence": "MIT",
}
COLUMNS = {
    **{name: paper.QUALITY[name] for name in ("psnr_db", "nonzero_psnr_db", "ssim")},
    **{name: paper.QUALITY[name] for name in ("explained_near", "explained_wide")},
    "widest_db": ("alpha .125, dB", ".1f"),
    "colour_error": ("colour error", ".2%"),
}
"""Columns of the page's table, their headings, and how their numbers are written."""


def by_labels(network: networks.NetworkRefocuser, fields: Iterable[LightField]) -> dict[str, dict[str, float]]:
    """Means over light fields of a network and of the mean of the views, by linear shift-and-sum, over whole frames."""
    cases = (EvaluationCase(IDEAL, each, shift_and_sum(each.views, PLANES.slopes), "labels") for each in fields)
    means = paper.scores(paper.plane_rows(cases, [paper.CLASSICAL[RIVAL], network], ())).droplevel("reference")
    return {name: {key: round(float(row[key]), 4) for key in COLUMNS} for name, row in means.iterrows()}


def table(network: networks.NetworkRefocuser, capture: Path) -> Iterator[str]:
    """Lines of the page: refnet and the mean of the views on a capture, whose planes are drawn."""
    light = read(capture, angular_size=[7, 7])
    sheet = pictures.contact_sheet(network(light, PLANES.slopes)[SHOWN], [PLANES.labels[n] for n in SHOWN])
    images.write_image(pages.PICTURES / "refnet_capture.jpg", sheet, quality=75)
    yield from pages.head("on a capture, by linear shift-and-sum", *(heading for heading, _ in COLUMNS.values()))
    for method, values in by_labels(network, [light]).items():
        yield pages.row(method, *(pages.number(values[name], form) for name, (_, form) in COLUMNS.items()))


def main() -> None:
    """Write `lfref/weights/refnet.safetensors`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, nargs="?")
    parser.add_argument("--capture", type=Path, help="a real light field, to measure refnet and draw its planes with")
    options = parser.parse_args()
    path = networks.SHIPPED["refnet"]
    if options.run is None:
        contents = checkpoint.read(path)
        command = contents["notes"]["command"]
    else:
        run = Run.of(options.run)
        contents = checkpoint.read(run.last)
        command = " ".join(["lfref train", *(word for word in run.overrides if not word.startswith(PLACES))])
    state = contents["state_dict"].items()
    contents["state_dict"] = {name: value.half() if value.numel() > LARGE else value for name, value in state}
    network = networks.restored_network(path, contents, "refnet")
    ideal = (ideal_case(scene, torch.zeros(1), CPU).light for scene in sim30.SCENES.values())
    fields = (dataclasses.replace(light, views=light.views.clamp(0, 1)) for light in ideal)
    facts = {
        "lfref": lfref.__version__,
        "command": command,
        "sim30": by_labels(network, fields),
        "card": REFNET_CARD,
    }
    checkpoint.write_weights(path, contents, facts)
    if options.capture is not None:
        pages.fill({"refnet": table(network, options.capture)})


if __name__ == "__main__":
    main()
