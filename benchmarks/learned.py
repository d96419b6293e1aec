"""Gains of the shipped network over other methods: the tables of `learned.md`.

The first is read from the tables of `lfref bench`.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd

from lfref.bench.evaluation import MEAN_CAP_DB
from lfref.nets import checkpoint
from lfref.refocuser import networks
from lfref.report import tables

RUNS = Path(__file__).resolve().parents[1] / "runs" / "figures"
LEARNED = "learned"
CLIPPED = "bokeh"
"""Its lamps clip on its sensor, so that no method can know how bright they are."""


def gains() -> Iterator[str]:
    """The network beside the best of all other methods, for each class of scenes."""
    yield (
        "| scenes | best rival | its PSNR, dB | learned, dB | gain | worst scene | worst alpha "
        "| Delta E 2000, rival and learned | brightness off by at most, rival and learned |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    methods = tables.read_table(RUNS / "bench" / "bench.csv")["method"].unique()
    rivals = [name for name in methods if name != LEARNED]
    for run, kind, title in (
        ("bench", "ideal", "sim30, thirty without a sensor"),
        ("bench", "aliased", "sim30, aliased, thirty without a sensor"),
        ("bench", "corrected", "sim30, seven with a sensor, corrected"),
        ("varied", "ideal", "drawn at random, without a sensor"),
        ("varied", "corrected", "drawn at random, with a sensor, corrected"),
    ):
        rows = tables.read_table(RUNS / run / "evaluation.csv")
        rows = rows[rows["class"] == kind]
        yield _gain(title, rows[rows["scene"] != CLIPPED] if kind == "corrected" else rows, rivals)


def _gain(title: str, rows: pd.DataFrame, rivals: list[str]) -> str:
    """One class of scenes: means, and where the network gains least."""
    psnr_db, delta_e, brightness = (
        rows.pivot(index=["scene", "alpha"], columns="method", values=name)
        for name in ("psnr_db", "delta_e", "brightness")
    )
    psnr_db = psnr_db.clip(upper=MEAN_CAP_DB)
    best = psnr_db[[name for name in rivals if name in psnr_db]].mean().idxmax()
    gains = psnr_db[LEARNED] - psnr_db[best]
    scenes, alphas = (gains.groupby(level).mean() for level in ("scene", "alpha"))
    cells = [
        f"{title} ({len(scenes)})" if "random" in title else title,
        str(best),
        f"{psnr_db[best].mean():.2f}",
        f"{psnr_db[LEARNED].mean():.2f}",
        f"{gains.mean():+.2f}",
        f"{scenes.min():+.2f} ({scenes.idxmin()})",
        f"{alphas.min():+.2f} ({alphas.idxmin():g})",
        " and ".join(f"{delta_e[name].mean():.3f}" for name in (best, LEARNED)),
        " and ".join(f"{(brightness[name] - 1).abs().max():.4f}" for name in (best, LEARNED)),
    ]
    return f"| {' | '.join(cells)} |"


def cards() -> Iterator[str]:
    """The model card, as the file of the weights holds it."""
    contents = checkpoint.read(networks.SHIPPED["learned"])
    notes = contents["notes"]
    n_weights = sum(value.numel() for value in contents["state_dict"].values())
    rows = {
        "what it does": notes["card"]["use"],
        "weights": f"{n_weights:,}, {networks.SHIPPED['learned'].stat().st_size / 1e6:.1f} MB",
        "data": notes["card"]["data"],
        "trained on": notes["card"]["trained_on"],
        "light fields, steps": f"{notes['fields']}, {notes['steps']:,}",
        "command": f"`{notes['command']}`",
        "gain on light fields held out": f"{notes['gain_db']:.2f} dB",
        "limits": notes["card"]["limits"],
        "licence of the weights": notes["card"]["licence"],
    }
    yield "| network | `learned` |"
    yield "|---|---|"
    for title, cell in rows.items():
        yield f"| {title} | {cell} |"


TABLES: dict[str, Callable[[], Iterator[str]]] = {"learned": gains, "cards": cards}
