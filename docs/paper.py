"""The paper's experiments at a size that two processors train, against the truth: tables and pictures of `paper.md`.

Run by `make paper`, which keeps networks and tables in `runs/paper`. With `--runs` elsewhere nothing is written into
the pages: `docs/paper.py --runs FOLDER --scenes twigs wall OVERRIDE ...` tries other networks.
"""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import experiments
import markers
import pandas as pd
import paper_pictures
import paper_speed
import paper_tables
import sheets
import training
from paper_methods import CLASSICAL, LABELS, NETWORKS, PARALLEL, PARALLEL_NETWORK, PLANES, SEEDS, sharpness

from lfref.bench import accuracy, evaluation
from lfref.bench.accuracy import Row
from lfref.geometry import FocalPlanes
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator import sim30

RUNS = markers.ROOT / "runs" / "paper"
SETUP = "experiment=paper_small"


@dataclass(frozen=True)
class Experiment:
    """Folder and size of the experiment."""

    runs: Path = RUNS
    scenes: tuple[str, ...] = tuple(sim30.SCENES)
    size: tuple[int, int] = paper_speed.SIZE
    """Height and width of the light field for the times."""
    overrides: tuple[str, ...] = ()
    """More overrides of `lfref train`."""

    @property
    def folders(self) -> dict[str, list[Path]]:
        """Method -> a run folder for each seed."""
        return {method: self._runs(label) for method, label in NETWORKS.items()}

    @property
    def parallel(self) -> dict[str, list[Path]]:
        """Run folders of the network whose planes follow the other convention."""
        return {PARALLEL_NETWORK: self._runs("parallel")}

    def overrides_by_run(self) -> dict[Path, list[str]]:
        """Run folder -> overrides of `lfref train`."""
        overrides = {}
        for label in (*NETWORKS.values(), "parallel"):
            words = ["label=shift_and_sum", "planes.convention=parallel"] if label == "parallel" else [f"label={label}"]
            for seed, folder in zip(SEEDS, self._runs(label), strict=True):
                overrides[folder] = [SETUP, *words, f"seed={seed}", *self.overrides]
        return overrides

    def _runs(self, label: str) -> list[Path]:
        return [self.runs / "networks" / label / f"seed_{seed}" for seed in SEEDS]


def measure(experiment: Experiment) -> dict[str, pd.DataFrame]:
    """Tables by truth, by labels, by planes in focus, and by labels in the other convention; made where missing."""
    networks, parallel = experiments.load_networks(experiment.folders), experiments.load_networks(experiment.parallel)
    runs = [run for folders in experiment.folders.values() for run in folders]
    methods: list[Refocuser] = [*CLASSICAL.values(), *networks]
    names, folder = experiment.scenes, experiment.runs

    def by_truth() -> Iterator[Row]:
        cases = experiments.cases(names, PLANES, with_sensor=True)
        return evaluation.evaluate(cases, methods, PLANES, experiments.MARGIN)

    return {
        "truth": experiments.cached_table(folder / "truth.csv", runs, by_truth),
        "labels": experiments.cached_table(folder / "labels.csv", runs, lambda: by_labels(names, methods, PLANES)),
        "focus": experiments.cached_table(folder / "focus.csv", runs, lambda: by_focus(names[::3], methods)),
        "parallel": experiments.cached_table(
            folder / "parallel.csv",
            experiment.parallel[PARALLEL_NETWORK],
            lambda: by_labels(names, [CLASSICAL["shift_and_sum"], *parallel], PARALLEL),
        ),
    }


def by_labels(names: Iterable[str], methods: Iterable[Refocuser], planes: FocalPlanes) -> Iterator[Row]:
    """Every method by each label source and by truth, over the whole frame, as the paper does."""
    for case in experiments.cases(names, planes):
        stacks = {method.name: case.stack(method, planes.slopes) for method in methods}
        labels = {label: CLASSICAL[label](case.light, planes.slopes) for label in LABELS}
        yield from accuracy.plane_rows(case.light.name, stacks, labels | {"truth": case.reference}, planes)


def by_focus(names: Iterable[str], methods: Iterable[Refocuser]) -> Iterator[Row]:
    """Sharpness of each plane over its truth's, and its distance from the most similar plane of the truth."""
    inside = (..., slice(experiments.MARGIN, -experiments.MARGIN), slice(experiments.MARGIN, -experiments.MARGIN))
    for case in experiments.cases(names, PLANES):
        truth = case.reference[inside]
        for method in methods:
            stack = case.stack(method, PLANES.slopes)[inside]
            nearest = ((stack[:, None] - truth[None]) ** 2).mean((2, 3, 4)).argmin(1)
            ratios = sharpness(stack) / sharpness(truth)
            for place, ratio, index in zip(accuracy.plane_names(PLANES), ratios.tolist(), nearest, strict=True):
                away = abs(PLANES.values[index] - place["slope"])
                yield {"method": method.name, "scene": case.light.name, **place, "sharpness": ratio, "away": away}


def main() -> None:
    """Train, evaluate, time, draw; then fill the pages, or print their lines."""
    experiment = _from_arguments()
    if failed := training.train(experiment.overrides_by_run()):
        raise SystemExit("\n".join(f"{folder}: {error}" for folder, error in failed.items()))
    rows = measure(experiment)
    speed = paper_speed.cached(experiment.runs / "speed.csv", experiment.size)
    lines = {name: "\n".join(table(rows)) for name, table in paper_tables.TABLES.items()}
    lines["paper_claims"] = "\n".join(paper_tables.claims(rows))
    lines["paper_speed"] = "\n".join(paper_speed.table(speed))
    is_ours = experiment.runs == RUNS
    pictures = markers.ROOT / "docs" / "pictures" if is_ours else experiment.runs / "pictures"
    for name, (draw, caption) in paper_pictures.DRAWN.items():
        sheets.save(draw(experiment.runs), pictures / name)
        lines[Path(name).stem] = f"![{caption}](pictures/{name})"
    if is_ours:
        markers.fill(lines)
    else:
        print(*(f"{name}\n{text}\n" for name, text in lines.items()), sep="\n")


def _from_arguments() -> Experiment:
    parser = argparse.ArgumentParser(description="The paper's experiments, against the truth.")
    parser.add_argument("overrides", nargs="*", help="of lfref train, with --runs elsewhere")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of networks and tables")
    parser.add_argument("--scenes", nargs="+", default=list(sim30.SCENES), help="of sim30, for the evaluation")
    parser.add_argument(
        "--size", nargs=2, type=int, default=paper_speed.SIZE, help="height and width of the light field for the times"
    )
    options = parser.parse_args()
    return Experiment(options.runs.resolve(), tuple(options.scenes), tuple(options.size), tuple(options.overrides))


if __name__ == "__main__":
    main()
