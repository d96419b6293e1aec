"""RefNet at full size, as a GPU trained it (`docs/gpu.py`), evaluated by its labels and by the truth.

`python docs/full_size.py` evaluates the networks in `runs/gpu/train_*` and writes `docs/full_size.csv`, from which
`docs/measure.py full_size` makes the table of `paper.md`. The weights (50 MB each) are not kept.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import experiments
import markers
import pandas as pd
import paper_tables
import torch
from paper_methods import CLASSICAL, PLANES

from lfref.bench import accuracy
from lfref.bench.accuracy import Row
from lfref.bench.evaluation import TRUTH
from lfref.io import run as runs
from lfref.io.run import Run
from lfref.refocuser.load import load
from lfref.report import tables
from lfref.simulator import sim30

RESULTS = markers.ROOT / "docs" / "full_size.csv"
RUNS = markers.ROOT / "runs" / "gpu"
PREFIX = "train_"
MEASURES = ["psnr_db", "ssim", "delta_e"]


def measure(folders: list[Path], device: torch.device) -> pd.DataFrame:
    """Means over the scenes of sim30, by network, reference and plane."""
    networks, facts = {}, {}
    for folder in folders:
        run, network = Run.of(folder), load(folder, device=device)
        network.name = folder.name.removeprefix(PREFIX)
        networks[network.name] = network
        facts[network.name] = {
            "label": run.config["label"]["refocuser"]["name"] if "refocuser" in run.config["label"] else TRUTH,
            "steps": runs.steps_done(run.best),
            "minutes": run.training["seconds"] / 60,
            "device": run.training["device"],
            "experiment": f"sim30 {sim30.VERSION}",
        }

    def rows() -> Iterator[Row]:
        for case in experiments.cases(sim30.SCENES, PLANES):
            for name, network in networks.items():
                label, references = facts[name]["label"], {TRUTH: case.reference}
                if label != TRUTH:
                    references[label] = CLASSICAL[label](case.light, PLANES.slopes)
                stack = case.stack(network, PLANES.slopes).cpu()
                for reference, picture in references.items():
                    compared = accuracy.plane_measures(case.displayed(stack), case.displayed(picture), margin=0)
                    qualities = accuracy.plane_rows(case.light.name, {name: stack}, {reference: picture}, PLANES)
                    for row, delta_e in zip(qualities, compared["delta_e"], strict=True):
                        yield row | {"delta_e": delta_e}

    means = pd.DataFrame(list(rows())).groupby(["method", "reference", "alpha"])[MEASURES].mean().reset_index()
    return means.join(pd.DataFrame(facts).T, on="method")


def table() -> Iterator[str]:
    """Each network by its labels and by the truth."""
    rows = tables.read_table(RESULTS)
    yield from paper_tables.head(
        "labels", "steps", "minutes", "by its labels, dB", "by truth, dB", "alpha .125", "alpha 1", "alpha 2", "Delta E"
    )
    for (label, steps, _), own in rows.groupby(["label", "steps", "method"]):
        by = dict(iter(own.groupby("reference")))
        planes = by[TRUTH].set_index("alpha")["psnr_db"]
        cells = [
            label,
            f"{steps:,.0f}",
            f"{own['minutes'].iloc[0]:.0f}",
            f"{by[label]['psnr_db'].mean():.1f}",
            f"{planes.mean():.1f}",
            *(f"{planes[alpha]:.1f}" for alpha in (0.125, 1.0, 2.0)),
            f"{by[TRUTH]['delta_e'].mean():.2f}",
        ]
        yield paper_tables.row(*cells)
    yield ""
    yield f"RefNet with 12.5 million parameters, one seed each; {rows['device'].iloc[0]}. Over the whole frame,"
    yield f"means of the 30 scenes of sim30 without sensors ({rows['experiment'].iloc[0]})."


TABLES = {"full_size": table}


def main() -> None:
    """Evaluate what was trained, and write the results."""
    parser = argparse.ArgumentParser(description="Evaluate RefNet at full size.")
    parser.add_argument("--runs", type=Path, default=RUNS, help=f"folder of the runs {PREFIX}*")
    parser.add_argument("--to", type=Path, default=RESULTS)
    options = parser.parse_args()
    folders = [path.parent.parent for path in sorted(options.runs.glob(f"{PREFIX}*/checkpoints/best.ckpt"))]
    if not folders:
        raise SystemExit(f"no networks in {options.runs}: make gpu trains them")
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    tables.write_table(options.to, measure(folders, device).round(6))


if __name__ == "__main__":
    main()
