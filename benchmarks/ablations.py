"""Ablations of a small RefNet that works: one training a row, evaluated against its labels and the truth on sim30.

Results go into `docs/ablations.csv` after each training. `make ablations` trains what is missing there, so that the
experiment goes on where it was stopped, on any machine. A row counts while its setup, read from the configuration, and
sim30 are the same.
"""

import functools
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pages
import pandas as pd
import paper
from omegaconf import OmegaConf
from paper import CLASSICAL, PLANES
from rich.progress import track

from lfref.bench.accuracy import RIVAL
from lfref.bench.evaluation import TRUTH, EvaluationCase
from lfref.cli import config as configs
from lfref.io.run import Run
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser
from lfref.report import tables
from lfref.simulator import sim30

RUNS, RESULTS = pages.ROOT / "runs" / "ablations", pages.ROOT / "docs" / "ablations.csv"
SETUP = ("experiment=paper_small",)
QUIET = tuple(f"+trainer.enable_{what}=false" for what in ("progress_bar", "model_summary"))
QUIET += ("~callbacks.progress", "~callbacks.summary", "~callbacks.pictures", "data.workers=0")
LABEL = "shift_and_sum"
METHODS = (RIVAL, LABEL)
"""Rows above the trainings."""
SMALL = OmegaConf.load(configs.directory() / "net" / "refnet_small.yaml")
DECISIVE = "net", "loss", "planes", "optimizer", "scheduler", "end_rate", "data"
"""Parts of the configuration by which a setup is known."""
BASE, LINEAR, RANDOM = "base", "net.initialization=linear", "net.initialization=random"
VARIANTS: dict[str, tuple[str, ...]] = {
    BASE: (),
    "relu": ("net.activation=relu",),
    "gelu": ("net.activation=gelu",),
    "no normalisation": ("net.normalization=none",),
    "layer normalisation": ("net.normalization=layer",),
    "beta 0: no SSIM": ("loss.weights.beta=0",),
    "beta 1: no L1": ("loss.weights.beta=1",),
    "gamma 0: no 1/PSNR": ("loss.weights.gamma=0",),
    "2 blocks": ("net.n_blocks=2",),
    "6 blocks": ("net.n_blocks=6",),
    "shuffle 1, the same reach": ("net.shuffle=1", f"net.dilation={[SMALL.shuffle * each for each in SMALL.dilation]}"),
    "dilation 1": ("net.dilation=1",),
    "dilations reversed": (f"net.dilation={list(SMALL.dilation)[::-1]}",),
    "stem of all colours, 3 x 3": ("net.stem_by_colour=false", "net.stem_kernel=3"),
    "no gains at the frame's edge": ("net.padding=zeros",),
    "equal rates": ("end_rate=1",),
    "random start": (RANDOM,),
    "random start, relu": (RANDOM, "net.activation=relu"),
    "random start, no normalisation": (RANDOM, "net.normalization=none"),
    "random start, equal rates": (RANDOM, "end_rate=1"),
}
"""What each row changes of the base."""
KEY = ["variant", "setup"]
MEASURES = {
    "label_psnr_db": ("against its labels, dB", ".1f"),
    "label_nonzero_psnr_db": ("without alpha 1, dB", ".1f"),
    "label_explained": ("explained", ".3f"),
    "label_explained_near": ("near", ".3f"),
    "label_explained_wide": ("wide", ".3f"),
    "label_widest_db": ("alpha .125, dB", ".1f"),
    "label_colour_error": ("colour error", ".2%"),
    "truth_psnr_db": ("against the truth, dB", ".1f"),
    "truth_nonzero_psnr_db": ("without alpha 1, dB", ".1f"),
}
"""Columns of the table, their headings, and how their numbers are written."""


class Member(NamedTuple):
    """One training, and its key among the results."""

    variant: str
    setup: str
    """Hash of all that determines the result: network, loss, steps, data, and the scenes of the evaluation."""
    overrides: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """Its run folder."""
        name = "".join(letter if letter.isalnum() else "_" for letter in self.variant)
        return RUNS / f"{name}_{self.setup}"


def members() -> Iterator[Member]:
    """All trainings, of seed 0."""
    for variant, changes in VARIANTS.items():
        words = (*SETUP, *changes, "seed=0")
        config = pages.composed("train", *words)
        parts = [sim30.VERSION, config.trainer.max_steps, config.trainer.precision]
        parts += [configs.plain(config[part]) for part in DECISIVE]
        digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
        yield Member(variant, f"setup_{digest[:12]}", words)


def results() -> pd.DataFrame:
    """The results so far, by any setup."""
    return tables.read_table(RESULTS) if RESULTS.exists() else pd.DataFrame(columns=KEY)


def train(wanted: Iterable[Member], cases: Sequence[EvaluationCase]) -> None:
    """Make the rows that are missing, and write each as it comes; the first failure ends the experiment."""
    done = set(results()[KEY].itertuples(index=False, name=None))
    for member in track([member for member in wanted if member[: len(KEY)] not in done], description="training"):
        rows = results()
        others = rows[rows["variant"] != member.variant]
        tables.write_table(RESULTS, [*others.to_dict("records"), trained(member, cases)])


def trained(member: Member, cases: Sequence[EvaluationCase]) -> dict[str, Any]:
    """The row of a training, which is trained first unless it is, in a process of one thread."""
    run = Run(member.folder)
    if not run.is_finished:
        words = ["train", *member.overrides, *QUIET, f"output={member.folder}", "resume=auto"]
        pages.lfref(*words, OMP_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    row = dict(zip(KEY, member, strict=False)) | {"n_parameters": run.training["n_parameters"]}
    return row | {"training_s": round(run.training["seconds"])} | measured(load(member.folder), cases)


def measured(method: Refocuser, cases: Sequence[EvaluationCase]) -> dict[str, float]:
    """Means over scenes and planes, against the labels (`label_`) and the truth (`truth_`)."""
    scores = paper.scores(paper.plane_rows(cases, [method, CLASSICAL[RIVAL]], [LABEL]))
    return {
        prefix + name: round(float(value), 5)
        for reference, prefix in ((LABEL, "label_"), (TRUTH, "truth_"))
        if reference != method.name
        for name, value in scores.loc[method.name, reference].items()
        if name not in ("n_db", "n_ssim")
    }


def times() -> dict[str, str]:
    """Time of every row for one light field; networks are untrained, since weights cost no time."""
    nets = {name: pages.composed("train", *SETUP, *changes, LINEAR).net for name, changes in VARIANTS.items()}
    options = {name: OmegaConf.to_yaml(net) for name, net in nets.items()}
    networks = {text: configs.build(OmegaConf.create(text)).eval() for text in set(options.values())}
    methods = {name: functools.partial(CLASSICAL[name], slopes=PLANES.slopes) for name in METHODS}
    measured = paper.times(methods | networks)
    return {name: measured[options.get(name, name)] for name in (*METHODS, *VARIANTS)}


def table(rows: pd.DataFrame, times: Mapping[str, str]) -> Iterator[str]:
    """All variants and methods."""
    headings = [heading for heading, _ in MEASURES.values()]
    yield from pages.head("variant", *headings, "difference from the base, dB", "parameters", paper.TIME)
    by_variant = rows.set_index("variant")
    base = by_variant.loc[BASE, "label_psnr_db"]
    for variant in (name for name in (*METHODS, *VARIANTS) if name in by_variant.index):
        own = by_variant.loc[variant]
        cells = [pages.number(own[name], form) or tables.DASH for name, (_, form) in MEASURES.items()]
        less = "" if variant in (BASE, *METHODS) else f"{own['label_psnr_db'] - base:+.1f}"
        size = pages.number(own["n_parameters"], ",.0f")
        yield pages.row(variant, *cells, less, size, times[variant])
    yield ""
    yield f"Whole frames of the 30 scenes of sim30 ({sim30.VERSION}) without sensors, the paper's planes, one training"
    yield "each. Near: alpha from .75, without 1; wide: up to .25. Time: of one light field of"
    yield f"7x7x3x{pages.SIZE[0]}x{pages.SIZE[1]}, in brackets divided by that of NumPy's 4-D FFT of the same views."


def main() -> None:
    """Train, evaluate, time; then fill the page."""
    wanted, cases = list(members()), list(paper.cases())
    train(wanted, cases)
    methods = [{"variant": name} | measured(CLASSICAL[name], cases) for name in METHODS]
    rows, keys = results(), {member[: len(KEY)] for member in wanted}
    rows = rows[[key in keys for key in rows[KEY].itertuples(index=False, name=None)]]
    pages.fill({"ablations": table(pd.concat([pd.DataFrame(methods), rows]), times())})


if __name__ == "__main__":
    main()
