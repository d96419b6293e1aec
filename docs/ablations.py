"""Ablations against the truth: the paper's choices over five seeds and two lengths; the tables of `ablations.md`.

Each variant gets a learning rate of its own, the best of `RATES` by a short training with another seed. Results go
into `docs/ablations.csv`, one row for each network: `make ablations` trains what is missing there, so that the
experiment goes on where it was stopped, on any machine. Rows by another version of the truth do not count. With
`--runs` elsewhere nothing is written into the pages.
"""

import argparse
import functools
import itertools
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import experiments
import markers
import pandas as pd
import torch
import training
from hydra import compose, initialize_config_dir
from paper_methods import PLANES
from rich.progress import track

from lfref.bench import evaluation, timing
from lfref.bench.evaluation import EvaluationCase
from lfref.cli import config as configs
from lfref.data.field_sources import SimulatedSource
from lfref.io.run import METRICS, Run
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.report import tables
from lfref.report.sweeps import t_interval
from lfref.simulator import sim30
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

RUNS = markers.ROOT / "runs" / "ablations"
RESULTS = markers.ROOT / "docs" / "ablations.csv"
SETUP = ("net=refnet_narrow", "scheduler=cosine", "data.patch=32", "data.patches_per_field=4")
N_FIELDS, SIZE = 180, 128
PAPER = "as the paper"
VARIANTS: dict[str, tuple[str, ...]] = {
    PAPER: (),
    "relu": ("net.activation=relu",),
    "gelu": ("net.activation=gelu",),
    "no normalisation": ("net.normalization=none",),
    "layer normalisation": ("net.normalization=layer",),
    "beta 0: no SSIM": ("loss.weights.beta=0",),
    "beta 1: no L1": ("loss.weights.beta=1",),
    "gamma 0: no 1/PSNR": ("loss.weights.gamma=0",),
    "4 blocks": ("net.n_blocks=4",),
    "shuffle 2": ("net.shuffle=2",),
}
"""Overrides beside the paper's choice: softplus, instance norm, beta .65, gamma 500, 11 blocks of 3x3."""
RATES = (0.0002, 0.0006, 0.002, 0.006)
N_SEEDS = 5
TUNING_SEED = 100
LENGTHS = {
    "short": ("trainer.max_epochs=4", "+trainer.limit_train_batches=40"),
    "long": ("trainer.max_epochs=10", "+trainer.limit_train_batches=160"),
}
"""160 and 1,600 steps; the learning rate falls along a cosine, epoch by epoch."""
LONGEST = {"longest": ("trainer.max_epochs=100", "+trainer.limit_train_batches=160")}
"""16,000 steps, an hour of one processor: for few variants."""
VARIANTS_LONGEST = (PAPER, "gamma 0: no 1/PSNR")
SCENES = tuple(sim30.SCENES)[::3]
WIDE, FOCUS = 0.25, 0.75  # alphas up to where blur is wide, and from where scenes are near focus
ROUNDS = 4  # of the measurement of time, of which the first is a warm-up
KEY = ["variant", "length", "seed", "rate"]
EXPERIMENT = f"{N_FIELDS} fields of {SIZE} px, sim30 {sim30.VERSION}"
"""What else determines a result: the light fields learned from, and the truth."""


@dataclass(frozen=True)
class Member:
    """One training."""

    variant: str
    length: str
    seed: int
    rate: float

    def folder(self, runs: Path) -> Path:
        """Its run folder."""
        name = "".join(letter if letter.isalnum() else "_" for letter in self.variant)
        return runs / name / f"{self.length}_{self.seed}_{self.rate:g}"

    @property
    def overrides(self) -> list[str]:
        """Overrides of `lfref train`, without those of the data."""
        own = (
            *VARIANTS[self.variant],
            *(LENGTHS | LONGEST)[self.length],
            f"optimizer.lr={self.rate:g}",
            f"seed={self.seed}",
        )
        return [*SETUP, *own]

    @property
    def key(self) -> dict[str, Any]:
        """Its place among the results."""
        return dict(zip(KEY, (self.variant, self.length, self.seed, self.rate), strict=True))


class Results:
    """The results so far, in a CSV file that is written after each training."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = pd.DataFrame(columns=[*KEY, "setup", "experiment"])
        if path.exists():
            rows = tables.with_numbers(tables.read_table(path), "seed").astype({"seed": int})
            self.rows = rows[rows["experiment"] == EXPERIMENT].reset_index(drop=True)
        self._lock = threading.Lock()

    def has(self, member: Member) -> bool:
        """Whether a training with these overrides is among the results."""
        return bool((self.rows["setup"] == " ".join(member.overrides)).any())

    def add(self, member: Member, values: Mapping[str, float]) -> None:
        """Add one training; it replaces one of the same variant, length, seed and rate with other overrides."""
        origin = {"setup": " ".join(member.overrides), "experiment": EXPERIMENT}
        row = pd.DataFrame([member.key | values | origin])
        with self._lock:
            others = self.rows[(self.rows[KEY] != list(member.key.values())).any(axis=1)]
            rows = pd.concat([others, row]) if len(others) else row
            by_variant = rows["variant"].map(list(VARIANTS).index)
            ordered = rows.assign(order=by_variant).sort_values(["length", "order", "rate", "seed"], ignore_index=True)
            self.rows = ordered.drop(columns="order")
            tables.write_table(self.path, self.rows)

    def of(self, length: str) -> pd.DataFrame:
        """Trainings of one length at the chosen rates, without those that chose them."""
        rows = self.rows[(self.rows["length"] == length) & (self.rows["seed"] != TUNING_SEED)]
        return rows[rows["rate"] == rows["variant"].map(self.best_rate)]

    def best_rate(self, variant: str) -> float | None:
        """The rate with the best validation of its short training; None until all of them are trained."""
        tried = self.rows[(self.rows["variant"] == variant) & (self.rows["seed"] == TUNING_SEED)]
        if not set(RATES) <= set(tried["rate"]):
            return None
        return float(tried.loc[tried["val_mpsnr_db"].idxmax(), "rate"])


@dataclass(frozen=True)
class Experiment:
    """Trains networks, and evaluates them against the truth."""

    runs: Path
    results: Results
    cases: Sequence[EvaluationCase]
    overrides: Sequence[str]
    """More overrides of `lfref train`, those of the data among them."""

    def run(self, members: Iterable[Member], n_processes: int, title: str) -> None:
        """Train what is missing; the first failure ends the experiment."""
        missing = [member for member in members if not self.results.has(member)]
        with ThreadPoolExecutor(n_processes) as pool:
            futures = [pool.submit(self._run_one, member) for member in missing]
            try:
                for future in track(as_completed(futures), description=title, total=len(futures)):
                    future.result()
            finally:
                pool.shutdown(wait=False, cancel_futures=True)

    def _run_one(self, member: Member) -> None:
        folder = member.folder(self.runs)
        if error := training.train_one(folder, [*member.overrides, *self.overrides]):
            raise SystemExit(f"{folder}: {error}")
        validations = tables.with_numbers(tables.read_table(folder / METRICS), "step", "val/mpsnr")
        values = {"val_mpsnr_db": validations["val/mpsnr"].max()}
        if member.seed != TUNING_SEED:
            values |= by_truth(load(folder), self.cases) | {"training_s": Run(folder).training["seconds"]}
        self.results.add(member, {name: round(float(value), 4) for name, value in values.items()})


def tuning() -> Iterator[Member]:
    """The trainings that choose a rate for each variant."""
    return (Member(variant, "short", TUNING_SEED, rate) for variant in VARIANTS for rate in RATES)


def members(length: str, variants: Iterable[str], results: Results, n_seeds: int) -> Iterator[Member]:
    """The trainings of one length, seed by seed, so that few seeds of all variants come before many of some."""
    for seed, variant in itertools.product(range(n_seeds), variants):
        rate = results.best_rate(variant)
        assert rate is not None, "rates are chosen first"
        yield Member(variant, length, seed, rate)


def prepare(folder: Path) -> Path:
    """The set of light fields to learn from, simulated and decoded if there is none."""
    lfref = [sys.executable, "-m", "lfref.cli.main"]
    if not (folder / "set" / "fields.json").exists():
        size = f"scene.camera.size=[{SIZE},{SIZE}]"
        fields = [f"n_fields={N_FIELDS}", size, "outputs=[views]", f"output={folder / 'fields'}", "overwrite=true"]
        subprocess.run([*lfref, "simulate", *fields], check=True)
        words = ["set=captures", f"set_folder={folder / 'set'}", f"output={folder / 'prepare'}", "overwrite=true"]
        subprocess.run([*lfref, "prepare", str(folder / "fields"), *words], check=True)
    return folder / "set"


@torch.no_grad()
def by_truth(network: NetworkRefocuser, cases: Iterable[EvaluationCase]) -> dict[str, float]:
    """Means over planes and scenes."""
    rows = pd.DataFrame(evaluation.evaluate(cases, [network], PLANES, experiments.MARGIN))
    return {
        "psnr_db": rows["psnr_db"].mean(),
        "wide_db": rows.loc[rows["alpha"] <= WIDE, "psnr_db"].mean(),
        "focus_db": rows.loc[rows["alpha"] >= FOCUS, "psnr_db"].mean(),
        "delta_e": rows["delta_e"].mean(),
    }


@torch.no_grad()
def costs(size: tuple[int, int]) -> pd.DataFrame:
    """Size of every network, untrained, and what a pass costs in NumPy's 4-D FFTs, all measured in turns."""
    views = SimulatedSource(1, 7, RandomScenes(Camera(size=size))).field(0).views
    networks = {}
    with initialize_config_dir(str(configs.directory()), version_base="1.3"):
        for variant, overrides in VARIANTS.items():
            networks[variant] = configs.build(compose("train", [*SETUP, *overrides]).net).eval()
    watches = {
        name: functools.partial(timing.seconds, functools.partial(network, views[None]), views.device)
        for name, network in networks.items()
    }
    watches[timing.FFT] = functools.partial(timing.numpy_fft_time, views)
    medians = {name: pd.Series(spent).median() for name, spent in timing.in_turns(watches, range(ROUNDS), 1).items()}
    return pd.DataFrame(
        {
            "variant": name,
            "n_parameters": sum(parameter.numel() for parameter in network.parameters()),
            "units": medians[name] / medians[timing.FFT],
        }
        for name, network in networks.items()
    )


def table(results: Results, sizes: pd.DataFrame) -> Iterator[str]:
    """Variants beside the paper's choice, at both lengths; differences are taken seed by seed."""
    yield (
        "| variant | parameters | time | rate | 160 steps, dB | less the paper's | 1,600 steps, dB | less the paper's "
        "| wide blur, dB | near focus, dB | Delta E |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    lengths = {length: results.of(length) for length in LENGTHS}
    sizes = sizes.set_index("variant")
    for variant in VARIANTS:
        rate = results.best_rate(variant)
        cells = [f"{sizes.loc[variant, 'n_parameters']:,.0f}", f"{sizes.loc[variant, 'units']:.2f}", f"{rate:g}"]
        for rows in lengths.values():
            own, base = (rows[rows["variant"] == name].set_index("seed") for name in (variant, PAPER))
            cells.append(_mean(own["psnr_db"]))
            cells.append("" if variant == PAPER else _difference((own["psnr_db"] - base["psnr_db"]).dropna()))
        longest = lengths["long"][lengths["long"]["variant"] == variant]
        cells += [_mean(longest[name]) for name in ("wide_db", "focus_db")] + [_mean(longest["delta_e"], ".2f")]
        yield f"| {' | '.join([variant, *cells])} |"
    yield ""
    counts = {length: rows.groupby("variant").size() for length, rows in lengths.items()}
    yield f"PSNR by truth, {len(SCENES)} scenes of sim30 (version {sim30.VERSION}) without a sensor, the paper's"
    yield f"planes, {experiments.MARGIN} px of the border left out; mean ± standard deviation over"
    yield f"{_span(counts['short'])} seeds after 160 steps, {_span(counts['long'])} after 1,600. Less the paper's: mean"
    yield "difference, seed by seed, with its 95 % paired t interval, bold where it excludes 0; each row is tested by"
    yield "itself. The last three columns are those of 1,600 steps. Rate: of learning, the best of"
    yield f"{', '.join(f'{rate:g}' for rate in RATES)} by the validation after 160 steps with another seed. Time in"
    yield "NumPy's 4-D FFTs of the same views. Wide blur: alpha up to"
    yield f"{WIDE:g}; near focus: from {FOCUS:g}."


def table_by_length(results: Results) -> Iterator[str]:
    """The variants that were trained longest, at all lengths."""
    yield "| variant | steps | seeds | by truth, dB | wide blur, dB | near focus, dB | Delta E |"
    yield "|---|---|---|---|---|---|---|"
    steps = dict(zip([*LENGTHS, *LONGEST], ("160", "1,600", "16,000"), strict=True))
    for variant, (length, n_steps) in itertools.product(VARIANTS_LONGEST, steps.items()):
        own = results.of(length)
        own = own[own["variant"] == variant]
        cells = [_mean(own[name]) for name in ("psnr_db", "wide_db", "focus_db")]
        cells.append(_mean(own["delta_e"], ".2f"))
        yield f"| {' | '.join([variant, n_steps, str(len(own)), *cells])} |"


def _span(counts: pd.Series) -> str:
    low, high = (counts.min(), counts.max()) if len(counts) else (0, 0)
    return f"{low}" if low == high else f"{low} to {high}"


def _mean(values: pd.Series, form: str = ".1f") -> str:
    if values.empty:
        return tables.DASH
    return f"{values.mean():{form}}" + (f" ± {values.std():{form}}" if len(values) > 1 else "")


def _difference(values: pd.Series) -> str:
    """The mean difference with its interval, bold if that excludes 0."""
    if len(values) < 2:
        return tables.DASH
    low, high = t_interval(values.tolist())
    text = f"{values.mean():+.1f} ({low:+.1f} to {high:+.1f})"
    return f"**{text}**" if low > 0 or high < 0 else text


def main() -> None:
    """Train, evaluate, time; then fill the page, or print its lines."""
    parser = argparse.ArgumentParser(description="The paper's choices, against the truth.")
    parser.add_argument("overrides", nargs="*", help="of lfref train, with --runs elsewhere")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of networks, and of results if not the default")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), help="of sim30, with --runs elsewhere")
    parser.add_argument("--processes", type=int, default=2, help="trainings side by side, of one thread each")
    parser.add_argument("--seeds", type=int, default=N_SEEDS, help="how many; more can be added later")
    parser.add_argument("--longest-seeds", type=int, default=1, help="of 16,000 steps, an hour of a processor each")
    parser.add_argument(
        "--size", nargs=2, type=int, default=(375, 540), help="height and width of the light field for the times"
    )
    options = parser.parse_args()
    runs = options.runs.resolve()
    is_ours = runs == RUNS
    if is_ours and (options.overrides or options.scenes != list(SCENES)):
        parser.error("other overrides and scenes need --runs elsewhere: they would mix with the results of the page")
    results = Results(RESULTS if is_ours else runs / "ablations.csv")
    data = ["data=folder", f"data.path={prepare(runs / 'data')}", "data.workers=0"]
    torch.set_num_threads(1)
    cases = list(experiments.cases(options.scenes, PLANES))
    experiment = Experiment(runs, results, cases, [*data, *options.overrides])
    experiment.run(tuning(), options.processes, "rates")
    for length in LENGTHS:
        experiment.run(members(length, VARIANTS, results, options.seeds), options.processes, length)
    longest = members(*LONGEST, VARIANTS_LONGEST, results, options.longest_seeds)
    experiment.run(longest, options.processes, *LONGEST)
    lines = {
        "ablations": "\n".join(table(results, costs(tuple(options.size)))),
        "ablations_length": "\n".join(table_by_length(results)),
    }
    if is_ours:
        markers.fill(lines)
    else:
        print(*lines.values(), sep="\n\n")


if __name__ == "__main__":
    main()
