"""Group `operators`: what every operator costs on one light field, in time and memory, and how time grows."""

import functools
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from omegaconf import DictConfig

from lfref.bench import cost, scaling
from lfref.bench.cost import Case
from lfref.bench.limits import shift_and_sum_limits
from lfref.bench.scaling import Scales, Size
from lfref.cli import config as configs
from lfref.cli.benches import shared
from lfref.cli.command import device_of, log, progress
from lfref.cli.planes import fixed
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.report import costs, drawing, tables


def operators(config: DictConfig, folder: Path) -> None:
    """Write `operators.csv`, `scaling.csv`, `exponents.csv`, `machine.json`, `operators.png` and `scaling.png`.

    Args:
        config: `conf/bench.yaml` with `group=operators`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), shared.rounds(config)
    scale_rounds = shared.rounds(config, "scale_repeats")
    planes = fixed(config)
    scales: Scales = configs.build(config.scales)
    in_numpy: dict[str, str] = configs.plain(config.in_numpy)
    field = _only_field(config).to(device)
    sizes = scales.sizes(Size(field.grid, field.size, len(planes)))
    cases = list(_cases(config, field, set(in_numpy.values())))
    rows = _costs(cases, planes, rounds, in_numpy)
    methods = {case.method.name: case.method for case in cases if case.method.name not in in_numpy.values()}
    views = functools.partial(scaling.random_views, channels=field.views.shape[2], device=device)
    growth = scaling.times(progress(list(methods.values()), "measuring growth"), sizes, views, *scale_rounds)
    _write(folder, rows, growth)
    limits = shift_and_sum_limits(field.views, len(planes))
    shared.write_facts(folder, device, [field], planes, rounds.counted, shift_and_sum_limits=limits._asdict())
    log.info("%d operators on %s: %s", len(cases), field.name, folder / "operators.csv")


def _only_field(config: DictConfig) -> LightField:
    fields = shared.light_fields(config)
    if len(fields) != 1:
        raise InputError("this group measures one light field", got=len(fields), remedy="give input=LIGHT_FIELD")
    return fields[0]


def _cases(config: DictConfig, field: LightField, on_cpu: set[str]) -> Iterator[Case]:
    """Every method on the field, as it is and, where asked for, as integers; sample weights are left out."""
    for method in configs.build(config.methods).values():
        views = field.views.cpu() if method.name in on_cpu else field.views
        has_planes_asked_for = method.name not in config.other_planes
        yield Case(method, views, has_planes_asked_for)
        if method.name in config.integer_input:
            yield Case(method, cost.as_integers(views), has_planes_asked_for)


def _costs(cases: list[Case], planes: FocalPlanes, rounds: shared.Rounds, in_numpy: dict[str, str]) -> pd.DataFrame:
    first = cost.first_calls(progress(cases, "first calls"), planes.slopes, ("psnr_db", "max_error"))
    times = cost.times(cases, planes.slopes, progress(rounds.all, "measuring rounds"), rounds.warmup, in_numpy)
    peaks = cost.peaks(progress(cases, "measuring memory"), planes.slopes)
    return cost.table(cost.OPERATORS, cost.facts(cases, len(planes)), first, times, peaks)


def _write(folder: Path, operators: pd.DataFrame, growth: pd.DataFrame) -> None:
    exponents = scaling.exponents(growth)
    for name, table in {"operators": operators, "scaling": growth, "exponents": exponents}.items():
        tables.write_table(folder / f"{name}.csv", table)
    drawing.save_figure(costs.operator_costs(operators), folder / "operators.png")
    drawing.save_figure(costs.growth(growth, exponents), folder / "scaling.png")
