"""Ablations against the truth: the paper's choices, and faster bodies of the network; the table of `ablations.md`.

Run by `make ablations`, which keeps its networks in `runs/ablations`, and the paper's own choice in `runs/paper`. With
`--runs` elsewhere nothing is written into the pages.
"""

import argparse
import functools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import experiments
import markers
import pandas as pd
import torch
import training
from paper_methods import PLANES, SEEDS

from lfref.bench import evaluation, timing
from lfref.bench.accuracy import Row
from lfref.data.field_sources import SimulatedSource
from lfref.refocuser.networks import NetworkRefocuser
from lfref.simulator import sim30
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

RUNS = markers.ROOT / "runs" / "ablations"
OURS = markers.ROOT / "runs" / "paper" / "networks" / "rendered"  # as the paper builds it
SETUP = ("experiment=paper_small", "label=rendered")
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
    "4 blocks, 64 wide": ("net.n_blocks=4", "net.widths=[64,64,64,64]", "net.stem_width=64"),
    "shuffle 2": ("net.shuffle=2",),
    "shuffle 4, stem 1x1": ("net.shuffle=4", "net.stem_kernel=1"),
    "kernel 5": ("net.kernel=5",),
    "dilation 2": ("net.dilation=2",),
}
"""Overrides beside the paper's choice: softplus, instance norm, beta .65, gamma 500, 11 blocks of 3x3."""
SCENES = tuple(sim30.SCENES)[::3]
WIDE, FOCUS = 0.25, 0.75  # alphas up to where blur is wide, and from where scenes are near focus
ROUNDS = 4  # of which the first is a warm-up


def folders(runs: Path) -> dict[str, list[Path]]:
    """Variant -> a run folder for each seed."""
    base = OURS if runs == RUNS else runs / PAPER.replace(" ", "_")
    names = {variant: runs / "".join(letter if letter.isalnum() else "_" for letter in variant) for variant in VARIANTS}
    return {variant: [folder / f"seed_{seed}" for seed in SEEDS] for variant, folder in (names | {PAPER: base}).items()}


def overrides_by_run(runs: Path, overrides: Iterable[str] = ()) -> dict[Path, list[str]]:
    """Run folder -> overrides of `lfref train`."""
    return {
        folder: [*SETUP, *VARIANTS[variant], f"seed={seed}", *overrides]
        for variant, of_seeds in folders(runs).items()
        for seed, folder in zip(SEEDS, of_seeds, strict=True)
    }


def by_truth(names: Sequence[str], networks: Sequence[NetworkRefocuser]) -> Iterator[Row]:
    """Every plane of every scene by every network."""
    return evaluation.evaluate(experiments.cases(names, PLANES), networks, PLANES, experiments.MARGIN)


def times(networks: Sequence[NetworkRefocuser], size: tuple[int, int]) -> Iterator[Row]:
    """Size of every network, and what a pass costs in NumPy's 4-D FFTs, all measured in turns."""
    views = SimulatedSource(1, 7, RandomScenes(Camera(size=size))).field(0).views
    watches = {
        each.name: functools.partial(timing.seconds, functools.partial(each, views), views.device) for each in networks
    }
    watches[timing.FFT] = functools.partial(timing.numpy_fft_time, views)
    medians = {name: pd.Series(spent).median() for name, spent in timing.in_turns(watches, range(ROUNDS), 1).items()}
    for each in networks:
        n_parameters = sum(parameter.numel() for parameter in each.network.parameters())
        yield {"method": each.name, "n_parameters": n_parameters, "units": medians[each.name] / medians[timing.FFT]}


def table(rows: pd.DataFrame, costs: pd.DataFrame) -> Iterator[str]:
    """Variants beside the paper's choice; differences are taken seed by seed."""
    yield "| variant | parameters | time | PSNR, dB | less the paper's | wide blur, dB | near focus, dB | Delta E |"
    yield "|---|---|---|---|---|---|---|---|"
    base = rows[rows["method"] == PAPER].groupby("seed")["psnr_db"].mean()
    for variant, members in rows.groupby("method", sort=False):
        cost = costs.set_index("method").loc[variant]
        wide, focus = (members[members["alpha"] <= WIDE], members[members["alpha"] >= FOCUS])
        cells = [f"{cost['n_parameters']:,.0f}", f"{cost['units']:.2f}", experiments.mean_and_range(members, "psnr_db")]
        cells.append("" if variant == PAPER else _gain(members.groupby("seed")["psnr_db"].mean() - base))
        cells += [experiments.mean_and_range(wide, "psnr_db"), experiments.mean_and_range(focus, "psnr_db")]
        yield f"| {' | '.join([str(variant), *cells, experiments.mean_and_range(members, 'delta_e', '.2f')])} |"
    yield ""
    yield f"PSNR by truth, {rows['scene'].nunique()} scenes of sim30 (version {sim30.VERSION}) without a sensor, the"
    yield f"paper's planes, {experiments.MARGIN} px of the border left out; mean of {len(SEEDS)} seeds (least to most)."
    yield "Differences are taken seed by seed, bold where all seeds agree on the sign. Time in NumPy's 4-D FFTs of the"
    yield f"same views. Wide blur: alpha up to {WIDE:g}; near focus: from {FOCUS:g}."


def _gain(differences: pd.Series) -> str:
    """The mean difference, the least and the most, and whether all seeds agree on its sign."""
    agrees = (differences > 0).all() or (differences < 0).all()
    text = f"{differences.mean():+.1f} ({differences.min():+.1f} to {differences.max():+.1f})"
    return f"**{text}**" if agrees else text


def main() -> None:
    """Train, evaluate, time; then fill the page, or print its lines."""
    parser = argparse.ArgumentParser(description="The paper's choices and faster bodies, against the truth.")
    parser.add_argument("overrides", nargs="*", help="of lfref train, with --runs elsewhere")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of networks and tables")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), help="of sim30, for the evaluation")
    parser.add_argument(
        "--size", nargs=2, type=int, default=(375, 540), help="height and width of the light field for the times"
    )
    options = parser.parse_args()
    runs = options.runs.resolve()
    failed = training.train(overrides_by_run(runs, options.overrides))
    complete = {variant: of_seeds for variant, of_seeds in folders(runs).items() if not failed.keys() & {*of_seeds}}
    sources = [run for of_seeds in complete.values() for run in of_seeds]
    rows = experiments.cached_table(
        runs / "truth.csv", sources, lambda: by_truth(options.scenes, experiments.load_networks(complete))
    )
    firsts = {variant: of_seeds[:1] for variant, of_seeds in complete.items()}
    with torch.no_grad():
        costs = experiments.cached_table(
            runs / "costs.csv", sources, lambda: times(experiments.load_networks(firsts), tuple(options.size))
        )
    lines = "\n".join(
        [*table(rows, costs), *(f"Training failed: {variant}." for variant in VARIANTS if variant not in complete)]
    )
    if runs == RUNS:
        markers.fill({"ablations": lines})
    else:
        print(lines)


if __name__ == "__main__":
    main()
