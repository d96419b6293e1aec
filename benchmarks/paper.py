"""The paper's claims, measured with small networks that work: tables and pictures of `paper.md`.

Run by `make paper`, with the networks of `make weights`, runs in `runs/weights`. With `--runs` elsewhere nothing is
written into the pages: `paper.py --runs FOLDER --network LABEL=PATH` evaluates another network, a run folder or a file.
`--speed` measures only times, with untrained networks, for `figures.py`.
Letters: `N` planes, `C H W` channel, pixel row and column, `u v` view column and row, `k` cycles per pixel.
"""

import argparse
import functools
import itertools
import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pages
import pandas as pd
import pictures
import torch
from matplotlib.figure import Figure
from pages import ALPHAS, CPU, PLANES, number, row
from rich.progress import track
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.bench import accuracy, evaluation, timing
from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH, EvaluationCase
from lfref.cli import config as configs
from lfref.data.datamodules import SimulatedSource
from lfref.io import atomic, write
from lfref.io.read import read
from lfref.lightfield import LightField
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import Refocuser
from lfref.report import drawing, tables
from lfref.report.drawing import BLACK, BLUE, CYAN, GREY, MAGENTA, RED, TEAL
from lfref.simulator import sim30
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

RUNS, WEIGHTS = pages.ROOT / "runs" / "paper", pages.ROOT / "runs" / "weights"
LABELS = ("shift_and_sum", "fourier_slice")
METHODS = (RIVAL, *LABELS, "fourier_slice_linear", "blockwise_wiener")
SETTINGS = pages.composed("bench").methods
CLASSICAL = {name: configs.build(SETTINGS[name]) for name in (*METHODS, "shift_and_sum_antialiased")}
NETWORKS = {
    "shift_and_sum": "RefNet on shift_and_sum",
    "fourier_slice": "RefNet on fourier_slice",
    "rendered": "RefNet on the truth",
}
"""Label source, a file of `conf/label` -> the method of its network."""
OWN = dict(zip(NETWORKS.values(), (*LABELS, TRUTH), strict=True))
"""Method of each network -> its labels."""
KEYS = ["method", "reference"]
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
"""Columns of the table, their headings, and how their numbers are written."""
TIME = "time, ms (in FFTs)"
SHOWN = 0.125, 0.25, 0.375, 0.5, 0.75, 1, 1.5, 2
"""Alphas in the table of planes."""
LAPLACIAN = torch.tensor([[0.0, 1.0, 0.0], [1.0, -4.0, 1.0], [0.0, 1.0, 0.0]])[None, None]


# Networks and methods on sim30


def cases() -> Iterator[EvaluationCase]:
    """Scenes of sim30 as a perfect sensor records them, with their truth at the paper's planes."""
    for name in track(list(sim30.SCENES), description="evaluating"):
        yield evaluation.ideal_case(sim30.SCENES[name], PLANES.slopes, CPU)


@torch.no_grad()
def plane_rows(cases: Iterable[EvaluationCase], methods: Sequence[Refocuser], labels: Sequence[str]) -> pd.DataFrame:
    """Every method by each label and by the reference, over the whole frame as in the paper, a row for each plane.

    No method gets the aperture of a scene, since networks have no input for it.
    """
    rows = []
    for case in cases:
        stacks = {method.name: method(case.light, PLANES.slopes) for method in methods}
        references = {label: CLASSICAL[label](case.light, PLANES.slopes) for label in labels}
        references[case.reference_name] = case.reference
        for (method, stack), (reference, label) in itertools.product(stacks.items(), references.items()):
            compared = accuracy.plane_rows(case.light.name, {method: stack}, {reference: label}, PLANES)
            delta_e = accuracy.colour_difference(stack, label).mean((-2, -1))
            more = zip(compared, delta_e.tolist(), (sharpness(stack) / sharpness(label)).tolist(), strict=True)
            rows += [row | {"delta_e": colour, "sharpness": ratio} for row, colour, ratio in more]
    return pd.DataFrame(rows)


def sharpness(stack: Tensor) -> Tensor:
    """Mean size of the Laplacian of every plane, [N, C, H, W] -> [N]."""
    return F.conv2d(stack.flatten(0, 1)[:, None], LAPLACIAN).abs().mean((1, 2, 3)).unflatten(0, stack.shape[:2]).mean(1)


def scores(rows: pd.DataFrame) -> pd.DataFrame:
    """Means of `plane_rows` by `KEYS`, also without slope 0; scenes of some quality; the share that is explained."""
    counted = accuracy.capped(rows, "psnr_db")
    means, nonzero, widest = (
        part.groupby(KEYS, sort=False)[["psnr_db", "ssim", "colour_error", "delta_e"]].mean()
        for part in (counted, counted[counted["slope"] != 0], counted[counted["alpha"] == ALPHAS[0]])
    )
    scenes = counted.groupby([*KEYS, "light_field"])[["psnr_db", "ssim"]].mean()
    counts = (scenes >= [LEAST_DB, LEAST_SSIM]).groupby(KEYS).sum().set_axis(["n_db", "n_ssim"], axis=1)
    means = means.join(nonzero.add_prefix("nonzero_")).assign(widest_db=widest["psnr_db"])
    return means.join(counts).join(accuracy.explained(rows, KEYS))


# Tables


def quality(scores: pd.DataFrame, pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Scores of methods by references."""
    yield from pages.head("method", "by", *(heading for heading, _ in QUALITY.values()))
    for pair in pairs:
        yield row(*pair, *(number(scores.loc[pair, name], form) for name, (_, form) in QUALITY.items()))


def claims(rows: pd.DataFrame, scores: pd.DataFrame) -> Iterator[str]:
    """The paper's claims one by one, and what was measured."""
    off = rows.assign(off=(rows["sharpness"] - 1).abs()).groupby(KEYS)["off"].mean()

    def beside(values: pd.Series, label: str, reference: str, form: str, *methods: str) -> str:
        names = {label: "labels", NETWORKS[label]: "network", RIVAL: "mean of the views"}
        shown = (*methods, NETWORKS[label], RIVAL)
        return ", ".join(f"{names[each]} {number(values[each, reference], form)}" for each in shown)

    yield from pages.head("claim", "what the paper compared", "measured here")
    for label in LABELS:
        n_db, n_ssim = (beside(scores[name], label, label, ".0f") for name in ("n_db", "n_ssim"))
        found = f"scenes of 30 from {LEAST_DB} dB: {n_db}; from an SSIM of {LEAST_SSIM}: {n_ssim}"
        yield row(f"imitates {label}", "30 captures, against the labels", found)
    compared = "a network on a GPU with NumPy's 4-D FFT on a CPU, which is no picture yet"
    ffts = {name: times[2] for name, times in json.loads(SPEED.read_text())["methods"].items()}
    found = ", ".join(f"{name} {ffts[name]:.2f}" for name in ("shift_and_sum", "RefNet, small", "RefNet"))
    yield row("134 times faster", compared, f"FFTs on one CPU: {found} ([Speed](#speed))")
    found = "shift-and-sum is real time on a CPU: [Speed](#speed)"
    yield row("real time only by learning", "neither method was timed as a whole", found)
    for label in LABELS:
        cast, difference = (
            beside(scores[name], label, TRUTH, form, label)
            for name, form in (("colour_error", ".2%"), ("delta_e", ".2f"))
        )
        found = f"error of the mean colour against the truth: {cast}; Delta E: {difference}"
        yield row(f"colours superior to {label}", "two captures, by eye", found)
        found = f"sharpness off by: {beside(off, label, label, '.0%')}"
        yield row(f"depth of field like {label}", "two captures, by eye", found)


def planes(rows: pd.DataFrame) -> Iterator[str]:
    """PSNR and sharpness of networks by their own labels, plane by plane."""
    means = accuracy.capped(rows, "psnr_db").groupby(["alpha", *KEYS])[["psnr_db", "sharpness"]].mean()
    pairs = [(RIVAL, "shift_and_sum"), *OWN.items()]
    columns = {"psnr_db": ("dB", ".1f"), "sharpness": ("sharpness", ".2f")}
    headings = [f"{method}, {unit}" for unit, _ in columns.values() for method, _ in pairs]
    yield from pages.head("alpha", "outer views move by, px", *headings)
    for place, alpha in ((place, alpha) for place, alpha in enumerate(ALPHAS) if alpha in SHOWN):
        cells = [number(means.loc[(alpha, *pair), name], form) for name, (_, form) in columns.items() for pair in pairs]
        yield row(f"{alpha:g}", f"{geometry.corner_shift(PLANES.slopes[[place]], (7, 7)):.1f}", *cells)
    yield ""
    yield f"Each network is compared with its own labels, `{RIVAL}` with those of shift_and_sum. Sharpness: mean size"
    yield "of the Laplacian divided by the label's."


# Times


@torch.no_grad()
def seconds(runs: Mapping[str, Callable[[], object]], views: Tensor, n_rounds: int = 3) -> pd.Series:
    """Median times, taken in turns with NumPy's 4-D FFT of the views; the first round warms up."""
    watches = {name: functools.partial(timing.seconds, run, CPU) for name, run in runs.items()}
    watches[timing.FFT] = functools.partial(timing.numpy_fft_time, views)
    return pd.DataFrame(timing.in_turns(watches, range(n_rounds), warmup=1)).median()


def timed_views() -> Tensor:
    """Views of a simulated light field to measure times with."""
    return SimulatedSource(1, 7, RandomScenes(Camera(size=pages.SIZE))).light(0).views


def times(methods: Mapping[str, Callable[[Tensor], object]]) -> dict[str, str]:
    """Milliseconds of each method for one light field, and in brackets NumPy's 4-D FFTs of the same views, as text."""
    views = timed_views()
    spent = seconds({name: functools.partial(method, views) for name, method in methods.items()}, views)
    return {name: f"{1e3 * spent[name]:,.0f} ({spent[name] / spent[timing.FFT]:.2f})" for name in methods}


SPEED = pages.FIGURES / "speed.json"


def measure_speed() -> None:
    """Times as the paper measures them, and from disk to pictures; slow methods take turns in fewer rounds."""
    views = timed_views()
    nets = {"RefNet": "refnet", "RefNet, small": "refnet_small"}
    built = {name: configs.build(pages.composed("train", f"net={file}").net) for name, file in nets.items()}
    slow = [NetworkRefocuser(network, PLANES, name) for name, network in built.items()]
    quick = [CLASSICAL[name] for name in (RIVAL, *LABELS, "shift_and_sum_antialiased", "blockwise_wiener")]
    figures: dict[str, Any] = timing.facts(CPU) | {"methods": {}}
    with tempfile.TemporaryDirectory() as folder:
        field = write.write(Path(folder) / "field", LightField(views))

        def from_disk(method: Refocuser) -> None:
            write.write_stack(Path(folder) / method.name, method(read(field), PLANES.slopes), PLANES, overwrite=True)

        for methods, n_rounds in ((quick, 6), (slow, 2)):
            runs: dict[str, Callable[[], object]] = {
                each.name: functools.partial(each, views, PLANES.slopes) for each in methods
            }
            runs |= {f"{each.name} from disk": functools.partial(from_disk, each) for each in methods}
            spent = seconds(runs, views, n_rounds)
            # One unit for all rows: in turns with the networks, the FFT took a third longer.
            fft = figures.setdefault("fft_s", spent[timing.FFT])
            for name in (each.name for each in methods):
                seconds_of = spent[name], spent[f"{name} from disk"]
                figures["methods"][name] = [*seconds_of, *(each / fft for each in seconds_of)]
    atomic.write_text(SPEED, json.dumps(figures, indent=1))


def speed_table() -> Iterator[str]:
    """Times of `measure_speed`."""
    figures = json.loads(SPEED.read_text())
    yield from pages.head("method", "one light field, s", "in FFTs", "from disk to pictures, s", "in FFTs")
    for name, (one, disk, one_ffts, disk_ffts) in figures["methods"].items():
        yield row(name, f"{one:.3f}", f"{one_ffts:.3f}", f"{disk:.2f}", f"{disk_ffts:.2f}")
    yield ""
    size = "x".join(map(str, pages.SIZE))
    yield f"Light fields of 7x7x3x{size}, 16 planes, float32; NumPy's FFT of one takes {figures['fft_s']:.2f} s."
    yield "From disk to pictures: 49 PNG files, already in the system's cache, are read, and 16 are written."
    yield "Shift-and-sum makes all planes"
    faster, refnet = 1 / figures["methods"]["shift_and_sum"][2], figures["methods"]["RefNet"][2]
    yield f"{faster:.0f} times faster than the FFT; RefNet takes {refnet:.1f} FFTs."
    yield f"{pages.machine(figures)}; medians."


COLOURS = {
    RIVAL: GREY,
    "shift_and_sum": BLUE,
    "fourier_slice": RED,
    "blockwise_wiener": BLACK,
    **dict(zip(NETWORKS.values(), (CYAN, MAGENTA, TEAL), strict=True)),
}


def scatter(rows: pd.DataFrame) -> Figure:
    """The paper's figure, a point a scene: networks against their own labels, and all methods against the truth."""
    points = accuracy.capped(rows, "psnr_db").groupby([*KEYS, "light_field"])[["psnr_db", "ssim"]].mean()
    own = [(NETWORKS[label], label) for label in LABELS]
    panels = {
        "as the paper: by their own labels": [(RIVAL, "shift_and_sum"), *own],
        "against the truth": [(method, TRUTH) for method in COLOURS],
    }
    figure = drawing.new_figure(pictures.WIDTH, 3.6)
    for axes, (title, pairs) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        for method, reference in pairs:
            look = {"color": COLOURS[method], "marker": "^" if method in OWN else "o", "label": method}
            of_pair = points.loc[method, reference]
            axes.plot(of_pair["ssim"], of_pair["psnr_db"], linestyle="", markersize=3.5, alpha=0.75, **look)
        pictures.label(axes, tables.heading("mssim"), tables.heading("mpsnr_db"), title)
    handles = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    figure.legend(handles=[*handles.values()], loc="outside lower center", ncols=3, frameon=False, fontsize=7)
    return figure


def main() -> None:
    """Evaluate, draw; then fill the pages, or print their lines."""
    parser = argparse.ArgumentParser(description="The paper's claims, measured.")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of the results")
    parser.add_argument("--network", action="append", default=[], metavar="LABEL=PATH", help="another run or file")
    parser.add_argument("--speed", action="store_true", help="measure only times")
    options = parser.parse_args()
    if options.speed or not SPEED.exists():
        measure_speed()
    if options.speed:
        return
    paths = {label: WEIGHTS / label for label in NETWORKS}
    paths |= {label: Path(path) for label, _, path in (each.partition("=") for each in options.network)}
    networks = []
    for label, path in paths.items():
        networks.append(load(path))
        networks[-1].name = NETWORKS[label]
    methods = [*(CLASSICAL[name] for name in METHODS), *networks]
    rows = plane_rows(cases(), methods, LABELS)
    tables.write_table(options.runs / "planes.csv", rows)
    by_pair = scores(rows)
    pairs = [(method, label) for label in LABELS for method in (RIVAL, NETWORKS[label])]
    pairs += [(method, TRUTH) for method in (*METHODS, *OWN)]
    lines = {
        "paper_claims": claims(rows, by_pair),
        "paper_quality": quality(by_pair, pairs),
        "paper_planes": planes(rows),
    }
    is_ours = options.runs == RUNS
    pictures.save(scatter(rows), (pages.PICTURES if is_ours else options.runs) / "paper_scatter.png")
    if is_ours:
        pages.fill(lines)
    else:
        print(*(f"{name}\n" + "\n".join(of_table) + "\n" for name, of_table in lines.items()), sep="\n")


if __name__ == "__main__":
    main()
