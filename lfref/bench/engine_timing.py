"""Networks that engines are measured on, each with simulated light fields and what a lens would have recorded of them.

Letters: `N` planes, `C H W` channel, pixel row and column.
"""

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import pandas as pd
import torch
from torch import Tensor, nn

from lfref.bench import memory, timing
from lfref.bench.accuracy import Row
from lfref.data.field_sources import SimulatedField
from lfref.engines import runtimes
from lfref.engines.engine import BF16, FP32, INT8, Inputs, Job, Run
from lfref.engines.runtimes import ENGINES
from lfref.errors import InputError, LfrefError, chosen, first_line
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.nets.network import Network
from lfref.refocuser import refined
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.refined import RefinedRefocuser


class Shot(NamedTuple):
    """One light field, as a network gets it."""

    scene: str
    """Its name."""
    parts: Sequence[Inputs]
    """What the network is given, one after the other, all of one shape."""
    truth: Tensor
    """What a lens would have recorded, in linear light, [N, C, H, W]."""

    def stack(self, run: Run) -> Tensor:
        """What a network makes of it, [N, C, H, W].

        Args:
            run: The network.
        """
        made = [run(*part) for part in self.parts]
        return made[0] if len(made) == 1 else torch.cat(made)


@dataclass(frozen=True, eq=False)
class Subject:
    """A network and what it is measured on."""

    name: str
    """As tables call it."""
    network: nn.Module
    """In evaluation mode."""
    is_trained: bool
    """Whether its pictures are to be judged by truth: without training they show nothing."""
    shots: Sequence[Shot]
    """At least one, all of one size."""
    patches: Sequence[Inputs]
    """Of other scenes, by which whole numbers are scaled."""

    @property
    def job(self) -> Job:
        """As engines take it."""
        return Job(self.network, self.shots[0].parts[0], self.patches)

    @property
    def device(self) -> torch.device:
        """Where it runs."""
        return self.job.device


class Fields(NamedTuple):
    """Simulated light fields."""

    whole: Sequence[SimulatedField]
    """What engines are timed and judged on."""
    patches: Sequence[SimulatedField]
    """Small ones, by which whole numbers are scaled."""


@torch.no_grad()
def of_network(
    name: str, network: Network, fields: Fields, planes: FocalPlanes, is_trained: bool, device: torch.device
) -> Subject:
    """A network that reads views.

    Args:
        name: As tables call it.
        network: Trained, or else its last layer is set so that its pictures are as bright as these scenes.
        fields: With its grid of views.
        planes: Those that it makes.
        is_trained: Whether it is.
        device: Where it runs.
    """
    if not is_trained:
        first = fields.patches[0]
        network.prime(first.views[None], planes.slopes, first.photograph(planes.values)[None])
    whole = [(field, [(field.views.to(device),)]) for field in fields.whole]
    shots = [Shot(field.name, parts, field.photograph(planes.values)) for field, parts in whole]
    patches = [(field.views.to(device),) for field in fields.patches]
    return Subject(name, network.eval().to(device), is_trained, shots, patches)


@torch.no_grad()
def of_refiner(refiner: RefinedRefocuser, fields: Fields, planes: FocalPlanes, device: torch.device) -> Subject:
    """The network of a method that is refined; it is given as many planes at once as in use.

    Args:
        refiner: Trained.
        fields: Of any grid of views.
        planes: What is refocused to.
        device: Where the network runs.
    """
    n_samples = int(refiner.refiner.config["n_features"]) * math.prod(fields.whole[0].size)
    n_at_once = _at_once(n_samples, len(planes))

    def parts(field: SimulatedField) -> list[Inputs]:
        split = refiner_inputs(field, planes.slopes, refiner.base, refiner.names, n_at_once)
        return [tuple(each.to(device).contiguous() for each in part) for part in split]

    shots = [Shot(field.name, parts(field), field.photograph(planes.values)) for field in fields.whole]
    patches = [part for field in fields.patches for part in parts(field)]
    return Subject(refiner.name, refiner.refiner.to(device), True, shots, patches)


def _at_once(n_samples: int, n_planes: int) -> int:
    """Planes that the network is given at once, all parts alike: an engine is prepared for one shape."""
    most = max(1, refined.AT_ONCE // n_samples)
    return max(count for count in range(1, n_planes + 1) if n_planes % count == 0 and count <= most)


# PART engines
# What each engine makes of a network: time, memory, how long it takes to get ready, and what accuracy it costs.
#
# Engines take turns on one light field after the other, so that a slow spell of the machine falls on all alike. The
# fastest passes are compared: whatever else a machine does only adds time. Letters: `N` planes.

Result = TypeVar("Result")

KEY = ["subject", "engine", "precision"]
COLUMNS = [
    *KEY, "start_s", "min_s", "median_s", "ratio_to_eager", "psnr_db", "loss_db", "agreement_db", "max_error",
    "extra_bytes", "skipped",
]  # fmt: skip
"""Of the summary. `start_s`: seconds from nothing to the first stack; `ratio_to_eager`: times faster than eager
float32; `psnr_db`: against truth, empty without training; `loss_db`: of it, beside eager float32; `agreement_db` and
`max_error`: PSNR and largest distance from eager float32; `extra_bytes`: memory beside network and inputs; `skipped`:
why there is no more."""
EAGER = ("eager", FP32)
PRECISIONS = (FP32, BF16, INT8)


class Ready(NamedTuple):
    """An engine that has made its first stack."""

    run: Run
    start_s: float
    """Seconds that preparing and the first pass took."""
    extra_bytes: int | None
    """Memory at the highest during the first pass, beside what was there before it was prepared."""


def choices(engines: Sequence[str] | None = None, precisions: Sequence[str] | None = None) -> list[tuple[str, str]]:
    """Engines and their precisions, eager float32 first, by which the others are judged.

    Args:
        engines: Keys of `ENGINES`; None: all.
        precisions: Some of `PRECISIONS`; None: all.

    Raises:
        InputError: There is no such engine or precision.
    """
    for precision in precisions or ():
        chosen("precision", precision, dict.fromkeys(PRECISIONS))
    wanted = PRECISIONS if precisions is None else precisions
    ways = {engine: chosen("engine", engine, ENGINES) for engine in (ENGINES if engines is None else engines)}
    kept = [(engine, precision) for engine, each in ways.items() for precision in each if precision in wanted]
    return [EAGER, *(choice for choice in kept if choice != EAGER)]


def ready(subject: Subject, engine: str, precision: str) -> Ready:
    """Prepare a network and have it make its first stack.

    Args:
        subject: The network.
        engine: A key of `ENGINES`.
        precision: One of its own.

    Raises:
        InputError: The engine cannot do that here.
    """
    _warm_up(engine, precision, subject.device)
    before = memory.resident(subject.device)

    def prepare() -> tuple[Run, float]:
        return timing.result_and_seconds(lambda: runtimes.prepared(engine, precision, subject.job), subject.device)

    run, seconds = _or_refused(prepare)
    first = functools.partial(timing.seconds, functools.partial(subject.shots[0].stack, run), subject.device)
    more, most = _or_refused(lambda: memory.highest(first, subject.device))
    return Ready(run, seconds + more, None if before is None or most is None else most - before)


def passes(subject: Subject, runs: dict[tuple[str, str], Run], rounds: Iterable[int]) -> Iterator[Row]:
    """Time and judge all engines in turns.

    Args:
        subject: The network.
        runs: What `ready` made, the first one the judge of the others.
        rounds: One number a round: which light field.

    Yields:
        Rows `subject, engine, precision, round, scene, seconds, psnr_db, agreement_db, max_error`.
    """
    for number in rounds:
        shot, judge = subject.shots[number % len(subject.shots)], None
        for (engine, precision), run in runs.items():
            call = functools.partial(shot.stack, run)
            stack, seconds = timing.result_and_seconds(call, subject.device)
            judge = stack if judge is None else judge
            names = {"subject": subject.name, "engine": engine, "precision": precision}
            place = {"round": number, "scene": shot.scene, "seconds": seconds}
            yield names | place | _quality(stack.cpu(), judge.cpu(), shot.truth.cpu(), subject.is_trained)


def summary(passed: pd.DataFrame, starts: pd.DataFrame) -> pd.DataFrame:
    """What the passes come to.

    Args:
        passed: Rows of `passes`; those of eager float32 among them.
        starts: Rows `subject, engine, precision` with `start_s` and `extra_bytes`, or `skipped`.

    Returns:
        `COLUMNS`, one row for each of the starts.
    """
    groups = passed.groupby(KEY, sort=False)
    table = groups.agg(
        min_s=("seconds", "min"),
        median_s=("seconds", "median"),
        psnr_db=("psnr_db", "mean"),
        agreement_db=("agreement_db", "mean"),
        max_error=("max_error", "max"),
    )
    judges = table.xs(EAGER, level=KEY[1:])
    of_judge = {name: table.index.get_level_values("subject").map(judges[name]) for name in ("min_s", "psnr_db")}
    table["ratio_to_eager"] = of_judge["min_s"] / table["min_s"]
    table["loss_db"] = of_judge["psnr_db"] - table["psnr_db"]
    started = starts.reindex(columns=[*KEY, "start_s", "extra_bytes", "skipped"])
    joined = started.merge(table.reset_index(), "left", KEY)
    return joined[COLUMNS].astype({"extra_bytes": "Int64"})


def fastest(summed: pd.DataFrame, most_db: float = 0.1) -> pd.DataFrame:
    """The fastest engine of each network among those that cost no more than that.

    Args:
        summed: Of `summary`.
        most_db: Decibels that may be lost; of networks without training, by which eager float32 would be changed at
            30 dB.

    Returns:
        Its rows, one a network.
    """
    # Errors of two kinds add up as squares: what is changed lies `apart` below an error of 30 dB.
    apart = -10 * math.log10(10 ** (most_db / 10) - 1)
    holds = summed["loss_db"].le(most_db).where(summed["loss_db"].notna(), summed["agreement_db"] >= 30 + apart)
    kept = summed[holds.astype(bool) & summed["min_s"].notna()]
    return kept.loc[kept.groupby("subject", sort=False)["min_s"].idxmin()]


def _warm_up(engine: str, precision: str, device: torch.device) -> None:
    """Load what an engine loads once, so that neither its time nor its memory count."""
    like = (torch.rand(1, 1, 32, 32, device=device),)
    job = Job(nn.Conv2d(1, 1, 3).eval().to(device), like, [like])
    _or_refused(lambda: runtimes.prepared(engine, precision, job)(*like))


def _or_refused(act: Callable[[], Result]) -> Result:
    """Other libraries raise whatever they stumble on over a network that they cannot run: that is a result."""
    try:
        return act()
    except LfrefError:
        raise
    except Exception as error:
        raise InputError("this engine must be able to run the network", got=first_line(error)) from error


def _quality(stack: Tensor, judge: Tensor, truth: Tensor, is_trained: bool) -> Row:
    return {
        "psnr_db": float(psnr(stack, truth).mean()) if is_trained else math.nan,
        "agreement_db": float(psnr(stack, judge).mean()),
        "max_error": float((stack - judge).abs().max()),
    }
