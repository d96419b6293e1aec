"""Group `engines`: which runtime runs a network fastest on this machine, and what accuracy and memory that costs."""

import functools
from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig

from lfref.bench import engine_subjects, machine
from lfref.bench import engines as measurements
from lfref.bench.accuracy import Row
from lfref.bench.engine_subjects import Fields, Subject
from lfref.cli import config as configs
from lfref.cli.benches import shared
from lfref.cli.command import device_of, log, paths, progress
from lfref.cli.planes import fixed
from lfref.data.sources import SimulatedSource
from lfref.engines.engine import Run
from lfref.errors import InputError, chosen
from lfref.geometry import FocalPlanes
from lfref.nets import checkpoint
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser, name_apart
from lfref.report import drawing, tables
from lfref.report import engines as picture

PACKAGES = ("onnxruntime", "openvino", "nncf")
Make = Callable[..., Subject]
"""(fields=..., device=...) -> a network and what it is measured on."""


def engines(config: DictConfig, folder: Path) -> None:
    """Write `engines.csv`, `passes.csv`, `machine.json` and `engines.png`; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=engines`.
        folder: The run folder.
    """
    device = device_of(config.device)
    choices = measurements.choices(configs.plain(config.engines), configs.plain(config.precisions))
    # Whatever is wrong with the words is told before scenes are drawn.
    kinds = {name: chosen("subjects", name, SUBJECTS) for name in configs.plain(config.subjects)}
    if not kinds:
        raise InputError(f"subjects must be some of {', '.join(SUBJECTS)}", got="none")
    repeats = {name: int(configs.number(config.passes, name, 1)) for name in kinds}
    makers = {name: kind(config) for name, kind in kinds.items()}
    fields = _fields(config)
    found = [
        _measured(make(fields=fields, device=device), choices, repeats[name])
        for name, of_kind in makers.items()
        for make in of_kind
    ]
    starts, passed = (pd.concat(parts) for parts in zip(*found, strict=True))
    table = measurements.summary(passed, starts)
    for name, rows in {"engines": table, "passes": passed}.items():
        tables.write_table(folder / f"{name}.csv", rows)
    drawing.save_figure(picture.engines(table), folder / "engines.png")
    packages = {package: machine.version(package) for package in PACKAGES}
    shared.write_facts(folder, device, fields.whole, fixed(config), max(repeats.values()), passes=repeats, **packages)
    for row in measurements.fastest(table).itertuples():
        log.info("%s: %s in %s is %.1f times faster", row.subject, row.engine, row.precision, row.ratio_to_eager)
    log.info("%d engines and precisions: %s", len(choices), folder / "engines.csv")


def _fields(config: DictConfig) -> Fields:
    """Light fields of the size that times are told of, and small ones of other scenes."""
    source: SimulatedSource = configs.build(config.source)
    small: SimulatedSource = configs.build(config.calibration)
    numbers = range(int(configs.number(config, "n_scenes", 1)))
    whole = [source.field(index) for index in progress(numbers, "drawing scenes")]
    return Fields(whole, [small.field(index) for index in range(len(small))])


def _networks(config: DictConfig) -> Sequence[Make]:
    """The checkpoints, or the network of the configuration without training."""
    trained, planes = [load(path) for path in paths(configs.plain(config.checkpoint))], fixed(config)
    if not trained:
        torch.manual_seed(0)
        network = configs.build(config.net)
        checkpoint.check_number(network, planes)
        return [functools.partial(engine_subjects.of_network, network.name, network, planes=planes, is_trained=False)]
    name_apart(trained)
    return [_trained(each, planes) for each in trained]


def _trained(trained: Refocuser, planes: FocalPlanes) -> Make:
    if not isinstance(trained, NetworkRefocuser):
        remedy = "give refiner_checkpoint=RUN"
        raise InputError("checkpoint must be of a network that reads views", got=trained.name, remedy=remedy)
    its_own, network = trained.planes or planes, trained.network
    return functools.partial(engine_subjects.of_network, trained.name, network, planes=its_own, is_trained=True)


def _refiners(config: DictConfig) -> Sequence[Make]:
    """The refiner that ships, or another one."""
    trained = load(config.refiner_checkpoint)
    if not isinstance(trained, RefinedRefocuser):
        remedy = "give checkpoint=RUN"
        raise InputError("refiner_checkpoint must be of a refiner", got=trained.name, remedy=remedy)
    return [functools.partial(engine_subjects.of_refiner, trained, planes=fixed(config))]


SUBJECTS: dict[str, Callable[[DictConfig], Sequence[Make]]] = {"network": _networks, "refiner": _refiners}
"""What engines can be measured on."""


def _measured(subject: Subject, choices: Sequence[tuple[str, str]], repeats: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """How engines start, and how they pass; what they hold is gone afterwards."""
    runs: dict[tuple[str, str], Run] = {}
    starts: list[Row] = []
    for engine, precision in progress(choices, f"{subject.name}: getting ready"):
        row: Row = {"subject": subject.name, "engine": engine, "precision": precision}
        try:
            made = measurements.ready(subject, engine, precision)
            runs[engine, precision] = made.run
            row |= {"start_s": made.start_s, "extra_bytes": made.extra_bytes}
        except InputError as error:
            log.info("%s %s is left out: %s", engine, precision, error)
            row |= {"skipped": str(error)}
        starts.append(row)
    rounds = progress(range(repeats), f"{subject.name}: passes of {len(runs)} engines")
    return pd.DataFrame(starts), pd.DataFrame(measurements.passes(subject, runs, rounds))
