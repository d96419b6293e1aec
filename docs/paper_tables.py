"""Tables of `paper.md`, lines of text from the tables of `paper.py`.

Letters: `s` seconds.
"""

from collections.abc import Callable, Iterator

import experiments
import pandas as pd
from paper_methods import CLASSICAL, LABELS, NETWORKS, PARALLEL, PARALLEL_NETWORK, PLANES, SEEDS

from lfref import geometry
from lfref.bench.evaluation import IDEAL, SENSOR
from lfref.simulator import sim30

Tables = dict[str, pd.DataFrame]
GRID = (7, 7)
LEAST, FEW = 25, 30  # decibels that the paper counts its scenes by
TRUTH = "truth"


def claims(tables: Tables) -> Iterator[str]:
    """The paper's claims one by one, and what was measured."""
    yield from head("claim", "what the paper compared", "measured here")
    yield row(
        "134 times faster",
        "a network on a GPU with NumPy's 4-D FFT on a CPU, which is no picture yet",
        "on one CPU, shift-and-sum makes all planes in a fraction of that FFT, and RefNet takes many: [Speed](#speed)",
    )
    yield row(
        "real time only by learning",
        "neither method was timed as a whole",
        "shift-and-sum is real time on a CPU: [Speed](#speed)",
    )
    ideal, focus = _ideal(tables).groupby("method"), tables["focus"].groupby("method")
    for label, method in zip(LABELS, NETWORKS, strict=False):
        delta, off = ([form(ideal.get_group(each)) for each in (label, method)] for form in (_delta_e, _off))
        measured = f"Delta E {delta[0]}, network {delta[1]}; brightness off by {off[0]}, network {off[1]}"
        yield row(f"colours superior to {label}", "two captures, by eye", measured)
        sharp, away = ([form(focus.get_group(each)) for each in (label, method)] for form in (_sharp, _away))
        measured = (
            f"sharpness over the truth's {sharp[0]}, network {sharp[1]}; plane off by {away[0]}, network {away[1]}"
        )
        yield row(f"depth of field and focus like {label}", "two captures, by eye", measured)


def quality(tables: Tables) -> Iterator[str]:
    """Accuracy, colour and brightness of every method, by truth."""
    yield from head(
        "method", "PSNR, dB", "SSIM", "Delta E", "brightness off by at most", "with a sensor, dB", "Delta E"
    )
    for method, rows in tables["truth"].groupby("method", sort=False):
        ideal, sensor = (rows[rows["class"] == name] for name in (IDEAL, SENSOR))
        cells = [
            experiments.mean_and_range(ideal, *column) for column in (("psnr_db",), ("ssim", ".3f"), ("delta_e", ".2f"))
        ]
        cells.append(f"{100 * (ideal['brightness'] - 1).abs().max():.1f} %")
        cells += [experiments.mean_and_range(sensor, *column) for column in (("psnr_db",), ("delta_e", ".2f"))]
        yield row(str(method), *cells)
    scenes = tables["truth"].groupby("class")["scene"].nunique()
    yield ""
    yield f"By truth, {scenes[IDEAL]} scenes of sim30 (version {sim30.VERSION}), {scenes.get(SENSOR, 0)} of them also"
    yield f"with a sensor; the paper's 16 planes, {experiments.MARGIN} px of the border left out. Networks: the mean of"
    yield f"{len(SEEDS)} seeds (least to most)."


def imitation(tables: Tables) -> Iterator[str]:
    """The paper's evaluation: a network against the labels that it learned from, beside these against the truth."""
    rows = tables["labels"]
    by_truth = rows[rows["reference"] == TRUTH].groupby("method")
    yield from head(
        "network", "by its labels, dB", "MSSIM", "below 25 dB", "below 30 dB", "labels by truth", "it by truth"
    )
    for method, label in NETWORKS.items():
        own = rows[(rows["method"] == method) & (rows["reference"] == (label if label in CLASSICAL else TRUTH))]
        scenes = own.groupby("light_field")["psnr_db"].mean()
        counts = [f"{(scenes < limit).sum()} of {len(scenes)}" for limit in (LEAST, FEW)]
        teacher = experiments.mean_and_range(by_truth.get_group(label), "psnr_db") if label in CLASSICAL else ""
        cells = [
            experiments.mean_and_range(own, "psnr_db"),
            experiments.mean_and_range(own, "ssim", ".3f"),
            *counts,
            teacher,
        ]
        yield row(method, *cells, experiments.mean_and_range(by_truth.get_group(method), "psnr_db"))
    yield ""
    yield "Over the whole frame, as in the paper; scenes are counted by the mean of all seeds."


def reach(tables: Tables) -> Iterator[str]:
    """PSNR of networks against shift-and-sum plane by plane, with planes by either convention."""
    yield from head(
        "alpha", "`ng`: outer views move by, px", "by its labels, dB", "`parallel`: px", "by its labels, dB"
    )
    series = (("labels", next(iter(NETWORKS)), PLANES), ("parallel", PARALLEL_NETWORK, PARALLEL))
    for place, alpha in enumerate(PLANES.alphas or ()):
        cells = []
        for name, method, planes in series:
            rows = tables[name]
            own = rows[(rows["method"] == method) & (rows["reference"] == "shift_and_sum") & (rows["alpha"] == alpha)]
            cells += [
                f"{geometry.corner_shift(planes.slopes[[place]], GRID):.1f}",
                experiments.mean_and_range(own, "psnr_db"),
            ]
        yield row(f"{alpha:g}", *cells)


def in_focus(tables: Tables) -> Iterator[str]:
    """Depth of field and focus: sharpness beside the truth's, and how far off the plane in focus is."""
    yield from head("method", "sharpness at alpha 0.125", "at alpha 1", "at alpha 2", "plane off by, px per view step")
    for method, rows in tables["focus"].groupby("method", sort=False):
        at = rows.groupby("alpha")
        cells = [experiments.mean_and_range(at.get_group(alpha), "sharpness", ".2f") for alpha in (0.125, 1.0, 2.0)]
        yield row(str(method), *cells, experiments.mean_and_range(rows, "away", ".3f"))
    yield ""
    yield "Sharpness: mean size of the Laplacian over that of the truth. Plane off by: from where it should be to the"
    yield f"plane of the truth that it is nearest to, in the mean; {tables['focus']['scene'].nunique()} scenes."


TABLES: dict[str, Callable[[Tables], Iterator[str]]] = {
    "paper_quality": quality,
    "paper_imitation": imitation,
    "paper_reach": reach,
    "paper_focus": in_focus,
}


def head(*cells: str) -> Iterator[str]:
    """The first row of a table, and the line below it."""
    yield row(*cells)
    yield row(*("---" for _ in cells))


def row(*cells: str) -> str:
    """A row of a table."""
    return f"| {' | '.join(cells)} |"


def _ideal(tables: Tables) -> pd.DataFrame:
    return tables["truth"][tables["truth"]["class"] == IDEAL]


def _delta_e(rows: pd.DataFrame) -> str:
    return experiments.mean_and_range(rows, "delta_e", ".2f")


def _off(rows: pd.DataFrame) -> str:
    return f"{100 * (rows['brightness'] - 1).abs().mean():.2f} %"


def _sharp(rows: pd.DataFrame) -> str:
    return f"{rows['sharpness'].median():.2f}"


def _away(rows: pd.DataFrame) -> str:
    return f"{rows['away'].mean():.3f} px"
