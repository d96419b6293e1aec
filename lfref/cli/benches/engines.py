"""Group `engines`: which runtime runs a network fastest on this machine, and what accuracy and memory that costs."""

from collections.abc import Iterator
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
from lfref.refocuser.networks import NetworkRefocuser, load
from lfref.refocuser.refined import RefinedRefocuser
from lfref.report import drawing, tables
from lfref.report import engines as picture

PACKAGES = ("onnxruntime", "openvino", "nncf")
REFINER = "give refiner_checkpoint=RUN"


def engines(config: DictConfig, folder: Path) -> None:
    """Write `engines.csv`, `passes.csv`, `machine.json` and `engines.png`; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=engines`.
        folder: The run folder.
    """
    device = device_of(config.device)
    choices = measurements.choices(configs.plain(config.engines), configs.plain(config.precisions))
    names = list(configs.plain(config.subjects))
    makers = [chosen("subjects", name, SUBJECTS) for name in names]
    repeats = {name: int(configs.number(config.passes, name, 1)) for name in names}
    fields = _fields(config)
    starts: list[Row] = []
    passed: list[Row] = []
    for name, make in zip(names, makers, strict=True):
        for subject in make(config, fields, device):
            runs = _ready(subject, choices, starts)
            rounds = progress(range(repeats[name]), f"{subject.name}: passes of {len(runs)} engines")
            passed += list(measurements.passes(subject, runs, rounds))
    table = measurements.summary(pd.DataFrame(passed), starts)
    for name, rows in {"engines": table, "passes": pd.DataFrame(passed)}.items():
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


def _networks(config: DictConfig, fields: Fields, device: torch.device) -> Iterator[Subject]:
    """The checkpoints, or the network of the configuration without training."""
    planes = fixed(config)
    for path in paths(configs.plain(config.checkpoint)):
        trained = load(path)
        if not isinstance(trained, NetworkRefocuser):
            raise InputError("checkpoint must be of a network that reads views", got=path, remedy=REFINER)
        yield engine_subjects.of_network(trained.name, trained.network, fields, trained.planes or planes, True, device)
    if config.checkpoint is None:
        torch.manual_seed(0)
        network = configs.build(config.net)
        yield engine_subjects.of_network(network.name, network, fields, planes, False, device)


def _refiners(config: DictConfig, fields: Fields, device: torch.device) -> Iterator[Subject]:
    """The refiner that ships, or another one."""
    trained = load(config.refiner_checkpoint)
    if not isinstance(trained, RefinedRefocuser):
        raise InputError("refiner_checkpoint must be of a refiner", got=trained.name, remedy="give checkpoint=RUN")
    yield engine_subjects.of_refiner(trained, fields, fixed(config), device)


SUBJECTS = {"network": _networks, "refiner": _refiners}
"""What engines can be measured on."""


def _ready(subject: Subject, choices: list[tuple[str, str]], starts: list[Row]) -> dict[tuple[str, str], Run]:
    """The engines that can run here; rows of all are added to the starts."""
    runs: dict[tuple[str, str], Run] = {}
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
    return runs
