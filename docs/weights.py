"""Put the network of a training run into the package, with how it was made: `python docs/weights.py RUN`.

Run by `make weights`.
"""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import yaml

import lfref
from lfref.cli import config as configs
from lfref.data import plane_sets
from lfref.io.run import Run
from lfref.nets import checkpoint
from lfref.refocuser import networks

PLACES = ("output=", "data.folder=", "data.cache_folder=")
LIMITS = """three channels of linear light, even grids; may be worse than the method that it corrects where that is \
nearly exact (beyond 70 dB), in planes close to fine stripes, and beyond the grids and disparities of its training"""


def notes(run: Run) -> dict[str, object]:
    """Training of the network of a run, and its accuracy on fields outside the training set."""
    validated = [row for row in run.metrics if row.get("val/gain") is not None]
    best = max(validated, key=lambda row: row["val/gain"] or 0.0)
    folder = Path(run.config["data"]["folder"] or _folder(run))
    return {
        "lfref": lfref.__version__,
        # Where it lies on a disk is nobody's concern.
        "command": " ".join(["lfref train", *(word for word in run.overrides if not word.startswith(PLACES))]),
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
    """Write `lfref/weights/learned.safetensors`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, nargs="?", help="none: only the card of the file is written again")
    parser.add_argument("--to", type=Path, default=networks.SHIPPED)
    parser.add_argument("--scale", type=float, default=1.0, help="factor of all corrections of a refiner")
    options = parser.parse_args()
    if options.run is None:
        contents = checkpoint.read(options.to)
        facts = contents["notes"]
    else:
        run = Run.of(options.run)
        facts, contents = notes(run), checkpoint.read(run.best)
    if options.scale != 1:
        facts["scale"], contents = options.scale, scaled(contents, options.scale)
    facts["card"] = card(facts)
    checkpoint.write_weights(options.to, contents, facts)
    print(yaml.safe_dump({**facts, "file": str(options.to), "bytes": options.to.stat().st_size}, sort_keys=False))


if __name__ == "__main__":
    main()
