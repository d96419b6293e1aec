"""Tables of the page on the simulator, from those of `lfref bench group=simulate`."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

from lfref.report import tables

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "simulate"
BRUTE = RUN.parent / "apertures" / "aperture.csv"
"""Takes most of an hour, so `make figures` does not make it; the page names the command."""
LARGE = 0.1
"""Share of a scene's time from which a pass is named."""


def costs() -> Iterator[str]:
    """Planned beside forced time by scene, and where the planned time goes."""
    passes = tables.read_table(RUN / "passes.csv").sort_values("share", ascending=False, kind="stable")
    large = passes[passes["share"] >= LARGE].groupby("scene")
    yield "| scene | views, ms | forced / planned | truth, ms | forced / planned | most of the time |"
    yield "|---|---|---|---|---|---|"
    for scene, members in tables.read_table(RUN / "simulate.csv").groupby("scene", sort=False):
        cells = [f"{1e3 * row.planned_s:.0f} | {row.forced_over_planned:.2f}" for row in members.itertuples()]
        named = ", ".join(f"{row['pass']} {100 * row['share']:.0f} %" for _, row in large.get_group(scene).iterrows())
        yield f"| {scene} | {' | '.join(cells)} | {named} |"
    facts = json.loads((RUN / "machine.json").read_text())
    yield ""
    yield f"Scenes of sim30 (version {facts['sim30']}), {facts['planes']} planes; {facts['processor']},"
    yield f"{facts['threads']} threads, {facts['repeats']} rounds. Random scenes of 3 to 5 surfaces, 192x192, one patch"
    yield "each, in as many processes as threads:"
    yield ""
    for row in tables.read_table(RUN / "rates.csv").itertuples():
        yield f"- {row.output}: {row.per_second:.1f} patches a second"


def distances() -> Iterator[str]:
    """Shift-and-sum of the views against the truth, plane by plane."""
    rows = tables.read_table(RUN / "alphas.csv")
    methods = rows["method"].unique()
    columns = [f"{method}, mean of at most 70 each, dB | median | worst scene" for method in methods]
    yield f"| alpha | {' | '.join(columns)} |"
    yield "|---" * (1 + 3 * len(methods)) + "|"
    for alpha, members in rows.groupby("alpha", sort=False):
        cells = [
            f"{row.mean_db:.1f} | {row.median_db:.1f} | {row.worst_db:.1f} ({row.worst_scene})"
            for row in members.itertuples()
        ]
        yield f"| {alpha:g} | {' | '.join(cells)} |"


def apertures() -> Iterator[str]:
    """The truth of every scene against brute force, its worst plane."""
    yield "| scene | worst of the planes, dB | which |"
    yield "|---|---|---|"
    for row in tables.read_table(BRUTE).itertuples():
        yield f"| {row.scene} | {row.psnr_db:.1f} | {row.worst_plane} |"


TABLES: dict[str, Callable[[], Iterator[str]]] = {"simulate": costs, "distances": distances}
if BRUTE.exists():
    TABLES["apertures"] = apertures
