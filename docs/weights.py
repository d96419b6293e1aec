"""Put the network of a training run into the package, with how it was made: `python docs/weights.py RUN`.

Run by `make weights`.
"""

import argparse
import json
from pathlib import Path

import yaml

import lfref
from lfref.cli import config as configs
from lfref.data import plane_sets
from lfref.io.run import Run
from lfref.nets import checkpoint
from lfref.refocuser import networks

PLACES = ("output=", "data.folder=", "data.cache_folder=")


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


def main() -> None:
    """Write `lfref/weights/learned.safetensors`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--to", type=Path, default=networks.SHIPPED)
    options = parser.parse_args()
    run = Run.of(options.run)
    facts = notes(run)
    checkpoint.write_weights(options.to, checkpoint.read(run.best), facts)
    print(yaml.safe_dump({**facts, "file": str(options.to), "bytes": options.to.stat().st_size}, sort_keys=False))


if __name__ == "__main__":
    main()
