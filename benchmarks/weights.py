"""Put the network of a training run into the package, with how it was made: `python benchmarks/weights.py NAME RUN`.

NAME is `learned` (a refiner) or `refnet`. Run by `make weights`.
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import markers
import pandas as pd
import torch
import yaml

import lfref
from lfref.bench import accuracy
from lfref.cli import config as configs
from lfref.data import planes as plane_sets
from lfref.geometry import planes_at_alphas
from lfref.io import images
from lfref.io.read import read
from lfref.io.run import Run
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.refocus.mean_of_views import mean_of_views
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import networks
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser
from lfref.report import pictures
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.simulate import simulate

PLACES = (
    "output=",
    "data.folder=",
    "data.cache_folder=",
    "data.workers=",
    "resume=",
    "callbacks.",
    "+trainer.enable_",
)
PLANES = planes_at_alphas([step / 8 for step in range(1, 17)])
LARGE = 100_000
"""Numbers in a weight from which RefNet's are stored in half precision."""
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
LIMITS = """three channels of linear light, even grids; may be worse than the method that it corrects where that is \
nearly exact (beyond 70 dB), in planes close to fine stripes, and beyond the grids and disparities of its training"""


def refnet_notes(run: Run, contents: Mapping[str, Any]) -> dict[str, object]:
    """Training of the RefNet of a run, and the accuracy of these weights on the scenes of sim30, by shift-and-sum."""
    network = networks.restored_network(run.last, contents, "refnet")
    return {"lfref": lfref.__version__, "command": command(run), "sim30": by_labels(network, scenes())}


def compact(contents: Mapping[str, Any]) -> dict[str, Any]:
    """A checkpoint of RefNet whose large weights are in half precision; the head's fix the colours of dark captures."""
    state = contents["state_dict"].items()
    return {**contents, "state_dict": {name: value.half() if value.numel() > LARGE else value for name, value in state}}


def scenes() -> Iterator[LightField]:
    """The scenes of sim30 as a perfect sensor records them."""
    for name, scene in sim30.SCENES.items():
        views = simulate(replace(scene, sensor=Sensor()), outputs=("views",), slopes=[0.0]).views
        assert views is not None
        yield LightField(views.clamp(0, 1), name)


@torch.no_grad()
def by_labels(network: Refocuser, fields: Iterable[LightField]) -> dict[str, dict[str, float]]:
    """Means over light fields of a network and of the mean of the views, by linear shift-and-sum, over whole frames."""
    methods = [network, OperatorRefocuser(accuracy.RIVAL, mean_of_views)]
    rows: list[accuracy.Row] = []
    for light in fields:
        name = light.name
        stacks = {method.name: method(light, PLANES.slopes) for method in methods}
        rows += accuracy.plane_rows(name, stacks, {"labels": shift_and_sum(light.views, PLANES.slopes)}, PLANES)
    planes = pd.DataFrame(rows)
    summary = accuracy.summaries(planes)
    means = summary.groupby("method").mean(numeric_only=True)
    means.update(accuracy.explained(planes, ["method", "reference"]).droplevel("reference"))
    for alpha in (0.25, 0.125):
        means[f"alpha_{alpha:g}_db"] = planes[planes["alpha"] == alpha].groupby("method")["psnr_db"].mean()
    counts = summary.assign(n_db=summary["mpsnr_db"] > 30, n_ssim=summary["mssim"] > 0.925).groupby("method")
    means = means.join(counts[["n_db", "n_ssim"]].sum())
    return {name: {key: round(float(value), 4) for key, value in row.items()} for name, row in means.iterrows()}


HEADINGS = {
    "mpsnr_db": ("MPSNR, dB", ".1f"),
    "nonzero_mpsnr_db": ("without alpha 1", ".1f"),
    "mssim": ("MSSIM", ".3f"),
    "n_db": ("above 30 dB", ".0f"),
    "n_ssim": ("above .925", ".0f"),
    "explained": ("explained", ".3f"),
    "explained_near": ("near", ".3f"),
    "explained_wide": ("wide", ".3f"),
    "alpha_0.25_db": ("alpha .25, dB", ".1f"),
    "alpha_0.125_db": ("alpha .125, dB", ".1f"),
    "colour_error": ("colour error", ".2%"),
}
"""Columns of the page's table, their headings, and how their numbers are written."""


def table(facts: Mapping[str, Any], capture: Path | None) -> Iterator[str]:
    """Lines of the page: refnet and the mean of the views on sim30, and on a capture, whose planes are drawn."""
    measured = {"sim30, 30 scenes": facts["sim30"]}
    if capture is not None:
        light, network = read(capture, views=[7, 7]), networks.refnet()
        measured["a capture, 383x552"] = by_labels(network, [light])
        stack, labels = network(light, PLANES.slopes), [PLANES.labels[n] for n in SHOWN]
        sheet = pictures.contact_sheet(stack[SHOWN], labels)
        images.write_image(markers.ROOT / "docs" / "pictures" / "refnet_capture.jpg", sheet, quality=75)
    yield f"| by linear shift-and-sum | method | {' | '.join(heading for heading, _ in HEADINGS.values())} |"
    yield "|---" * (len(HEADINGS) + 2) + "|"
    for data, methods in measured.items():
        for method, values in methods.items():
            cells = (f"{values[name]:{form}}" for name, (_, form) in HEADINGS.items())
            yield f"| {data} | {method} | {' | '.join(cells)} |"
    yield ""
    yield f"Whole frames; trained by `{facts['command']}`."


def command(run: Run) -> str:
    """The command line of a run; where it lies on a disk is nobody's concern."""
    return " ".join(["lfref train", *(word for word in run.overrides if not word.startswith(PLACES))])


def notes(run: Run) -> dict[str, object]:
    """Training of the refiner of a run, and its accuracy on fields outside the training set."""
    validated = [row for row in run.metrics if row.get("val/gain") is not None]
    best = max(validated, key=lambda row: row["val/gain"] or 0.0)
    folder = Path(run.config["data"]["folder"] or _folder(run))
    return {
        "lfref": lfref.__version__,
        "command": command(run),
        "set": json.loads((folder / "set.json").read_text("utf-8")),
        "fields": len(list(folder.glob(f"*{plane_sets.SUFFIX}"))),
        "steps": int(best["step"] or 0) + 1,
        "gain_db": best["val/gain"],
        "mpsnr_db": best["val/mpsnr"],
    }


def _folder(run: Run) -> Path:
    """Folder of the set of a run in the cache."""
    recipe = configs.build(run.config["recipe"])
    return plane_sets.folder_of(recipe, Path(run.config["data"]["cache_folder"]).expanduser())


def card(facts: Mapping[str, Any]) -> dict[str, Any]:
    """The model card in a file of weights: for whom, of what data, with which limits, under which licence."""
    recipe = facts["set"]
    grids = ", ".join(f"{rows}x{columns}" for rows, columns in sorted(set(map(tuple, recipe["grids"]))))
    reach = max(recipe["depths"]) * max(map(abs, recipe["scenes"]["disparities"]))
    return {
        "use": "corrects the pictures of occlusion_aware: refocused pictures of light fields at any slopes",
        "data": "scenes of lfref's simulator, drawn at random, with their truth as labels; no photographs",
        "trained_on": f"grids of {grids} views, disparities of up to {reach:g} px per view step",
        "limits": LIMITS,
        "licence": "MIT",
    }


def scaled(contents: Mapping[str, Any], scale: float) -> dict[str, Any]:
    """A checkpoint of a refiner whose corrections are multiplied by a factor: all of its shares, not its gate."""
    weights, sizes = dict(contents["state_dict"]), contents["lfref"]["refiner"]
    n_shares = sizes["n_candidates"] * sizes["shuffle"] ** 2
    for name in ("net.head.1.weight", "net.head.1.bias"):
        weights[name] = torch.cat([scale * weights[name][:n_shares], weights[name][n_shares:]])
    return {**contents, "state_dict": weights}


def main() -> None:
    """Write `lfref/weights/NAME.safetensors`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=list(networks.SHIPPED))
    parser.add_argument("run", type=Path, nargs="?", help="none: only the card of the file is written again")
    parser.add_argument("--to", type=Path, help="another file")
    parser.add_argument("--capture", type=Path, help="a real light field, to measure refnet and draw its planes with")
    parser.add_argument("--scale", type=float, default=1.0, help="factor of all corrections of a refiner")
    options = parser.parse_args()
    path, is_refnet = options.to or networks.SHIPPED[options.name], options.name == "refnet"
    if options.run is None:
        contents = checkpoint.read(path)
        facts = contents["notes"]
    else:
        run = Run.of(options.run)
        contents = checkpoint.read(run.last if is_refnet else run.best)
        contents = compact(contents) if is_refnet else contents
        facts = refnet_notes(run, contents) if is_refnet else notes(run)
    if options.scale != 1:
        facts["scale"], contents = options.scale, scaled(contents, options.scale)
    facts["card"] = REFNET_CARD if is_refnet else card(facts)
    checkpoint.write_weights(path, contents, facts)
    if is_refnet and options.to is None:
        markers.fill({"refnet": "\n".join(table(facts, options.capture))})
    print(yaml.safe_dump({**facts, "file": str(path), "bytes": path.stat().st_size}, sort_keys=False))


if __name__ == "__main__":
    main()
