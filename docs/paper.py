"""The paper's claims, measured with small networks that work: tables and pictures of `paper.md`.

Run by `make paper`. The networks are those of `make weights`, runs in `runs/weights`; what is missing there is trained.
With `--runs` elsewhere nothing is written into the pages: `docs/paper.py --runs FOLDER --network LABEL=PATH` evaluates
another network, a run folder or a file.
"""

import argparse
import functools
from collections.abc import Iterator, Mapping
from pathlib import Path

import experiments
import markers
import pandas as pd
import paper_pictures
import sheets
import training
from experiments import ALPHAS, CLASSICAL, KEYS, NETWORKS, PLANES, SEED

from lfref import geometry
from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH
from lfref.report import tables
from lfref.simulator import sim30

RUNS = markers.ROOT / "runs" / "paper"
LABELS = ("shift_and_sum", "fourier_slice")
METHODS = (RIVAL, *LABELS, "fourier_slice_linear", "occlusion_aware")
OWN = dict(zip(NETWORKS.values(), (*LABELS, TRUTH), strict=True))
"""Method of each network -> its labels."""
BY_LABELS = [(method, label) for label in LABELS for method in (RIVAL, NETWORKS[label])]
BY_TRUTH = [(method, TRUTH) for method in (*METHODS, *OWN)]
LEAST_DB, LEAST_SSIM = 30, 0.925
"""Quality by which scenes are counted."""
QUALITY = {
    "psnr_db": ("MPSNR, dB", ".1f"),
    "ssim": ("MSSIM", ".3f"),
    "n_db": (f"scenes from {LEAST_DB} dB", ".0f"),
    "n_ssim": (f"from {LEAST_SSIM}", ".0f"),
    "nonzero_psnr_db": ("without alpha 1: MPSNR, dB", ".1f"),
    "nonzero_ssim": ("MSSIM", ".3f"),
    "explained_near": ("explained, near", ".3f"),
    "explained_wide": ("wide", ".3f"),
}
COLOUR = {
    "colour_error": ("colour error", ".2%"),
    "nonzero_colour_error": ("without alpha 1", ".2%"),
    "delta_e": ("Delta E", ".2f"),
    "nonzero_delta_e": ("without alpha 1", ".2f"),
}
"""Columns of the tables, their headings, and how their numbers are written."""


def scored(rows: pd.DataFrame) -> pd.DataFrame:
    """Scores of every method by every reference, and how many scenes reach `LEAST_DB` and `LEAST_SSIM`."""
    means = rows.groupby([*KEYS, "light_field"])[["psnr_db", "ssim"]].mean()
    counts = (means >= [LEAST_DB, LEAST_SSIM]).groupby(KEYS).sum().set_axis(["n_db", "n_ssim"], axis=1)
    return experiments.scores(rows).join(counts).reset_index()


def of(rows: pd.DataFrame, method: str, reference: str) -> pd.DataFrame:
    """Rows of a method, for a network those of all its seeds, by a reference."""
    return rows[(rows["method"].str.partition(SEED)[0] == method) & (rows["reference"] == reference)]


def written(rows: pd.DataFrame, column: str, form: str) -> str:
    """Mean of a column, and the least and the largest mean of a network if there are several, as text."""
    means = rows.groupby("method")[column].mean()
    low, mean, high = (f"{value:{form}}".replace("%", " %") for value in (means.min(), means.mean(), means.max()))
    return mean if len(means) == 1 else f"{mean} ({low} to {high})"


def claims(rows: pd.DataFrame, scores: pd.DataFrame, times: Mapping[str, str]) -> Iterator[str]:
    """The paper's claims one by one, and what was measured."""
    yield from experiments.head("claim", "what the paper compared", "measured here")
    for label in LABELS:
        n_db, n_ssim = (_beside(scores, label, label, (NETWORKS[label], RIVAL), each) for each in ("n_db", "n_ssim"))
        what = f"scenes of 30 from {LEAST_DB} dB: {n_db}; from an SSIM of {LEAST_SSIM}: {n_ssim}"
        yield experiments.row(f"imitates {label}", "30 captures, by the labels", what)
    what = "; ".join(f"{method} {times[method]}" for method in ("shift_and_sum", *OWN))
    yield experiments.row(
        "134 times faster",
        "a network on a GPU with NumPy's 4-D FFT on a CPU, which is no picture yet",
        f"ms (FFTs) on one CPU: {what}; the network at full size: [Speed](#speed)",
    )
    what = "shift-and-sum is real time on a CPU: [Speed](#speed)"
    yield experiments.row("real time only by learning", "neither method was timed as a whole", what)
    for label in LABELS:
        columns = {"colour_error": "error of the mean colour by the truth", "delta_e": "Delta E"}
        methods = label, NETWORKS[label], RIVAL
        found = "; ".join(f"{text}: {_beside(scores, label, TRUTH, methods, name)}" for name, text in columns.items())
        yield experiments.row(f"colours superior to {label}", "two captures, by eye", found)
        off = rows.assign(off=(rows["sharpness"] - 1).abs())
        found = _beside(off, label, label, (NETWORKS[label], RIVAL), "off")
        yield experiments.row(f"depth of field like {label}", "two captures, by eye", f"sharpness off by: {found}")


def _beside(rows: pd.DataFrame, label: str, reference: str, methods: tuple[str, ...], column: str) -> str:
    forms = {name: form for name, (_, form) in (QUALITY | COLOUR).items()} | {"off": ".0%"}
    names = {label: "labels", NETWORKS[label]: "network", RIVAL: "mean of the views"}
    return ", ".join(f"{names[each]} {written(of(rows, each, reference), column, forms[column])}" for each in methods)


def table(
    scores: pd.DataFrame, pairs: list[tuple[str, str]], columns: dict[str, tuple[str, str]], times: Mapping[str, str]
) -> Iterator[str]:
    """Scores of methods by references."""
    yield from experiments.head("method", "by", *(heading for heading, _ in columns.values()), experiments.TIME)
    for method, reference in pairs:
        own = of(scores, method, reference)
        cells = [written(own, name, form) for name, (_, form) in columns.items()]
        yield experiments.row(method, reference, *cells, times[method])


def planes(rows: pd.DataFrame) -> Iterator[str]:
    """PSNR and sharpness of networks by their own labels, plane by plane."""
    pairs = [(RIVAL, "shift_and_sum"), *OWN.items()]
    columns = {"psnr_db": ("dB", ".1f"), "sharpness": ("sharpness", ".2f")}
    headings = [f"{method}, {unit}" for unit, _ in columns.values() for method, _ in pairs]
    yield from experiments.head("alpha", "outer views move by, px", *headings)
    for place, alpha in enumerate(ALPHAS):
        of_plane = rows[rows["alpha"] == alpha]
        cells = [written(of(of_plane, *pair), name, form) for name, (_, form) in columns.items() for pair in pairs]
        yield experiments.row(f"{alpha:g}", f"{geometry.corner_shift(PLANES.slopes[[place]], (7, 7)):.1f}", *cells)
    yield ""
    yield f"Each network by its own labels, `{RIVAL}` by shift_and_sum; sharpness: mean size of the Laplacian over that"
    yield "of the label."


def main() -> None:
    """Train what is missing, evaluate, draw; then fill the pages, or print their lines."""
    parser = argparse.ArgumentParser(description="The paper's claims, measured.")
    parser.add_argument("overrides", nargs="*", help="of lfref train, for networks that are missing")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of the results")
    parser.add_argument("--weights", type=Path, default=experiments.WEIGHTS, help="folder of the networks")
    parser.add_argument("--network", action="append", default=[], metavar="LABEL=PATH", help="another run or file")
    parser.add_argument("--scenes", nargs="+", default=list(sim30.SCENES), help="of sim30")
    parser.add_argument("--seeds", type=int, default=1, help="how many networks of each label source")
    options = parser.parse_args()
    paths = experiments.runs(options.seeds, options.weights)
    paths |= {label: [Path(path)] for label, _, path in (each.partition("=") for each in options.network)}
    for label, seed, folder in ((label, seed, path) for label, own in paths.items() for seed, path in enumerate(own)):
        if folder.parent == options.weights:
            training.train(folder, [*experiments.RECIPES[label], f"seed={seed}", *options.overrides])
    networks = experiments.networks(paths)
    methods = [*(CLASSICAL[name] for name in METHODS), *networks]
    rows = experiments.plane_rows(experiments.cases(options.scenes, PLANES), methods, LABELS)
    tables.write_table(options.runs / "planes.csv", rows)
    scores = scored(rows)
    first = [network for network in networks if network.name.endswith(f"{SEED}0")]
    timed = [CLASSICAL[name] for name in METHODS] + first
    calls = {each.name.partition(SEED)[0]: functools.partial(each, slopes=PLANES.slopes) for each in timed}
    times = experiments.times(calls)
    lines = {
        "paper_claims": claims(rows, scores, times),
        "paper_quality": table(scores, [*BY_LABELS, *BY_TRUTH], QUALITY, times),
        "paper_colour": table(scores, [*BY_LABELS, *BY_TRUTH], COLOUR, times),
        "paper_planes": planes(rows),
    }
    texts = {name: "\n".join(of_table) for name, of_table in lines.items()}
    is_ours = options.runs == RUNS
    pictures = markers.ROOT / "docs" / "pictures" if is_ours else options.runs / "pictures"
    drawn = {
        "paper_scatter.png": paper_pictures.scatter(rows),
        "paper_comparison.jpg": paper_pictures.comparison(first),
    }
    for name, figure in drawn.items():
        sheets.save(figure, pictures / name)
        texts[Path(name).stem] = f"![{paper_pictures.CAPTIONS[name]}](pictures/{name})"
    if is_ours:
        markers.fill(texts)
    else:
        print(*(f"{name}\n{text}\n" for name, text in texts.items()), sep="\n")


if __name__ == "__main__":
    main()
