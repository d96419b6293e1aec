"""Table of the page on the simulator: what the planner saves, and which passes take the time."""

import functools
import itertools
import statistics
from collections.abc import Callable, Iterator

import torch

from lfref.bench import timing
from lfref.simulator import sim30
from lfref.simulator.simulate import PAPER, simulate

NAMES = ("plane", "edge", "twigs", "floor", "dome", "gloss", "window", "running", "vignetting", "grainy", "everything")
"""Scenes of sim30, each of another class."""
ROUNDS, CPU = 2, torch.device("cpu")
LARGE = 0.1
"""Share of a scene's time from which a pass is named."""


def costs() -> Iterator[str]:
    """Time of planned beside that of all passes, in turns, and where the planned time goes."""
    watches = {}
    for name, output, is_forced in itertools.product(NAMES, ("views", "truth"), (False, True)):
        scene = sim30.SCENES[name]
        run = functools.partial(simulate, scene, outputs=(output,), slopes=PAPER.slopes, force=is_forced)
        watches[name, output, is_forced] = functools.partial(timing.seconds, run, CPU)
    times = timing.in_turns(watches, range(ROUNDS + 1), warmup=1)
    median = {key: statistics.median(seconds) for key, seconds in times.items()}
    yield "| scene | views, ms | all passes / planned | truth, ms | all passes / planned | most of the time |"
    yield "|---|---|---|---|---|---|"
    for name in NAMES:
        cells = []
        for output in ("views", "truth"):
            planned, forced = median[name, output, False], median[name, output, True]
            cells.append(f"{1e3 * planned:.0f} | {forced / planned:.2f}")
        timed = simulate(sim30.SCENES[name], outputs=("views", "truth"), slopes=PAPER.slopes, timed=True).rows
        passes = sorted(((row.milliseconds or 0, row.name) for row in timed), reverse=True)
        total = sum(milliseconds for milliseconds, _ in passes)
        largest = ", ".join(f"{step} {100 * ms / total:.0f} %" for ms, step in passes if ms >= LARGE * total)
        yield f"| {name} | {' | '.join(cells)} | {largest} |"
    facts = timing.facts(CPU)
    yield ""
    yield f"Scenes of sim30 (version {sim30.VERSION}), {len(PAPER)} planes; {facts['processor']},"
    yield f"{facts['threads']} threads, medians of {ROUNDS} rounds."


TABLES: dict[str, Callable[[], Iterator[str]]] = {"simulate": costs}
