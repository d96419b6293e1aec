"""Time, memory, start and loss of accuracy of a network in each engine.

Networks are measured on simulated light fields, whose truth is known. Engines take turns on one light field after the
other, so that a slow spell of the machine falls on all alike. The fastest passes are compared: other work on a machine
only adds time. Letters: `N` planes, `C H W` channel, pixel row and column.
Each group of `lfref bench` has a module of its own.
"""

import functools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd
import torch
from torch import Tensor, nn

from lfref.bench import memory, timing
from lfref.bench.accuracy import Row
from lfref.data.field_sources import SimulatedField
from lfref.engines import runtimes
from lfref.engines.engine import BF16, FP32, INT8, EngineWorkload, Inputs, NetworkFunction
from lfref.engines.runtimes import ENGINES
from lfref.errors import InputError, LfrefError, chosen, first_line
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.nets.network import Network
from lfref.refocuser import networks
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.networks import RefinedRefocuser


class FieldInputs(NamedTuple):
    """One light field as the inputs of a network."""

    scene: str
    parts: Sequence[Inputs]
    """Inputs of each pass, all of one shape."""
    truth: Tensor
    """The lens's pictures in linear light, [N, C, H, W]."""

    def stack(self, run: NetworkFunction) -> Tensor:
        """The stack of a network that an engine runs, [N, C, H, W]."""
        outputs = [run(*part) for part in self.parts]
        return outputs[0] if len(outputs) == 1 else torch.cat(outputs)


@dataclass(frozen=True, eq=False)
class NetworkCase:
    """A network and the light fields on which it is measured."""

    name: str
    network: nn.Module
    """The network in evaluation mode."""
    is_trained: bool
    """False: its pictures are meaningless, so they are not compared with the truth."""
    fields: Sequence[FieldInputs]
    """Inputs of at least one light field, all of one size."""
    calibration: Sequence[Inputs]
    """Inputs of other scenes that scale int8."""

    @property
    def workload(self) -> EngineWorkload:
        """The network as engines take it."""
        return EngineWorkload(self.network, self.fields[0].parts[0], self.calibration)


class Fields(NamedTuple):
    """Simulated light fields."""

    whole: Sequence[SimulatedField]
    """Light fields for time and accuracy."""
    calibration: Sequence[SimulatedField]
    """Small light fields that scale int8."""


@torch.no_grad()
def network_case(
    name: str, network: Network, fields: Fields, planes: FocalPlanes, is_trained: bool, device: torch.device
) -> NetworkCase:
    """A network that reads views; without training its weights start on one of these scenes."""
    if not is_trained:
        first = fields.calibration[0]
        network.initialize(first.views[None], planes.slopes, first.photograph(planes.values)[None])
    whole = [
        FieldInputs(field.name, [(field.views.to(device),)], field.photograph(planes.values)) for field in fields.whole
    ]
    calibration = [(field.views.to(device),) for field in fields.calibration]
    return NetworkCase(name, network.eval().to(device), is_trained, whole, calibration)


@torch.no_grad()
def refiner_case(refiner: RefinedRefocuser, fields: Fields, planes: FocalPlanes, device: torch.device) -> NetworkCase:
    """The network of a refined method; a pass gets as many planes as in normal use."""
    n_samples = int(refiner.corrector.config["n_features"]) * math.prod(fields.whole[0].size)
    most = max(1, networks.AT_ONCE // n_samples)
    # All parts have the same number of planes, since an engine is prepared for one shape.
    n_at_once = max(n for n in range(1, len(planes) + 1) if len(planes) % n == 0 and n <= most)

    def parts(field: SimulatedField) -> list[Inputs]:
        inputs = refiner_inputs(field, planes.slopes, refiner.base, refiner.names, n_at_once)
        return [tuple(tensor.to(device).contiguous() for tensor in tensors) for tensors in inputs]

    whole = [FieldInputs(field.name, parts(field), field.photograph(planes.values)) for field in fields.whole]
    calibration = [part for field in fields.calibration for part in parts(field)]
    return NetworkCase(refiner.name, refiner.corrector.to(device), True, whole, calibration)


KEY = ["network", "engine", "precision"]
COLUMNS = [
    *KEY, "start_s", "min_s", "median_s", "ratio_to_eager", "psnr_db", "loss_db", "agreement_db", "max_error",
    "extra_bytes", "skipped",
]  # fmt: skip
"""Columns of `summary`. `start_s`: seconds from preparation to the first stack; `ratio_to_eager`: times faster than
eager float32; `psnr_db`: PSNR against the truth, empty without training; `loss_db`: PSNR of eager float32 minus
`psnr_db`; `agreement_db`, `max_error`: PSNR and largest distance from eager float32; `extra_bytes`: memory beside
network and inputs; `skipped`: why there is no result."""
EAGER = ("eager", FP32)
"""The engine and precision with which others are compared."""
PRECISIONS = (FP32, BF16, INT8)


class StartedEngine(NamedTuple):
    """An engine after its first stack."""

    run: NetworkFunction
    start_s: float
    """Seconds of preparation and the first pass."""
    extra_bytes: int | None
    """Peak memory of the first pass beyond that before preparation."""


def choices(engines: Sequence[str] | None = None, precisions: Sequence[str] | None = None) -> list[tuple[str, str]]:
    """Engines and their precisions, eager float32 first.

    Args:
        engines: Keys of `ENGINES`; None: all.
        precisions: Some of `PRECISIONS`; None: all.

    Raises:
        InputError: There is no such engine or precision.
    """
    for precision in precisions or ():
        chosen("precision", precision, dict.fromkeys(PRECISIONS))
    ways = {engine: chosen("engine", engine, ENGINES) for engine in (ENGINES if engines is None else engines)}
    pairs = [(engine, precision) for engine, by_precision in ways.items() for precision in by_precision]
    return [EAGER, *(it for it in pairs if it != EAGER and it[1] in (PRECISIONS if precisions is None else precisions))]


def start(case: NetworkCase, engine: str, precision: str) -> StartedEngine:
    """Prepare a network for an engine and make the first stack.

    Raises:
        InputError: The engine cannot run this network in this precision here.
    """
    device = case.workload.device
    prepare = functools.partial(runtimes.prepare, engine, precision)
    try:
        # A tiny network runs first, so that libraries that are loaded once count neither as time nor as memory.
        tiny = (torch.rand(1, 1, 32, 32, device=device),)
        prepare(EngineWorkload(nn.Conv2d(1, 1, 3).eval().to(device), tiny, [tiny]))(*tiny)

        before = memory.resident(device)
        run, prepare_s = timing.result_and_seconds(functools.partial(prepare, case.workload), device)
        first = functools.partial(timing.seconds, functools.partial(case.fields[0].stack, run), device)
        first_s, most = memory.highest(first, device)
    except LfrefError:
        raise
    except Exception as error:  # libraries raise errors of any kind for a network that they cannot run
        raise InputError("this engine must be able to run the network", got=first_line(error)) from error
    return StartedEngine(run, prepare_s + first_s, None if before is None or most is None else most - before)


def passes(case: NetworkCase, runs: Mapping[tuple[str, str], NetworkFunction], rounds: Iterable[int]) -> Iterator[Row]:
    """Time and compare all engines in turns.

    Args:
        case: The network.
        runs: (engine, precision) -> started engine; the others are compared with the first.
        rounds: One number per round; light fields take turns by it.

    Yields:
        Rows `network, engine, precision, round, scene, seconds, psnr_db, agreement_db, max_error`.
    """
    for number in rounds:
        field, reference = case.fields[number % len(case.fields)], None
        for (engine, precision), run in runs.items():
            stack, seconds = timing.result_and_seconds(functools.partial(field.stack, run), case.workload.device)
            stack = stack.cpu()
            reference = stack if reference is None else reference
            yield {
                "network": case.name,
                "engine": engine,
                "precision": precision,
                "round": number,
                "scene": field.scene,
                "seconds": seconds,
                "psnr_db": float(psnr(stack, field.truth.cpu()).mean()) if case.is_trained else math.nan,
                "agreement_db": float(psnr(stack, reference).mean()),
                "max_error": float((stack - reference).abs().max()),
            }


def summary(passes: pd.DataFrame, starts: pd.DataFrame) -> pd.DataFrame:
    """Starts and passes of every engine in one row: `COLUMNS`.

    Args:
        passes: Rows of `passes`, with those of eager float32.
        starts: Rows `network, engine, precision` with `start_s` and `extra_bytes`, or `skipped`.
    """
    table = passes.groupby(KEY, sort=False).agg(
        min_s=("seconds", "min"),
        median_s=("seconds", "median"),
        psnr_db=("psnr_db", "mean"),
        agreement_db=("agreement_db", "mean"),
        max_error=("max_error", "max"),
    )
    eager = table.xs(EAGER, level=KEY[1:])
    names = table.index.get_level_values("network")
    table["ratio_to_eager"] = names.map(eager["min_s"]) / table["min_s"]
    table["loss_db"] = names.map(eager["psnr_db"]) - table["psnr_db"]
    joined = starts.reindex(columns=[*KEY, "start_s", "extra_bytes", "skipped"]).merge(table.reset_index(), "left", KEY)
    return joined[COLUMNS].astype({"extra_bytes": "Int64"})


def fastest(summary: pd.DataFrame, most_db: float = 0.1) -> pd.DataFrame:
    """The row of the fastest engine of each network among those that lose at most `most_db`.

    Args:
        summary: Table that `summary` returns.
        most_db: Largest loss, in dB; nobody sees 0.1. The loss of a network without training is what its distance from
            eager float32 would cost at 30 dB.
    """
    # Errors add up as squares: 30 dB minus `most_db` is an error of 30 dB plus a change `distance` dB below it.
    distance = -10 * math.log10(10 ** (most_db / 10) - 1)
    holds = summary["loss_db"].le(most_db).where(summary["loss_db"].notna(), summary["agreement_db"] >= 30 + distance)
    accurate = summary[holds.astype(bool) & summary["min_s"].notna()]
    return accurate.loc[accurate.groupby("network", sort=False)["min_s"].idxmin()]
