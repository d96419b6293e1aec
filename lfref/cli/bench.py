"""`lfref bench`: measurements in groups; `group=NAME` selects one function of `GROUPS`.

Shared first: rounds, light fields, scenes, facts of the machine. Then one section per group.
"""

import functools
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import torch
from omegaconf import DictConfig

from lfref.bench import engine_timing, error_causes, evaluation, operator_costs, simulation_cost, timing
from lfref.bench.accuracy import Row
from lfref.bench.engine_timing import Fields, NetworkCase
from lfref.bench.error_causes import CauseSettings
from lfref.bench.evaluation import CORRECTIONS, EvaluationCase
from lfref.bench.operator_costs import MethodCase, Scales, Size
from lfref.bench.stability import components as stability_components
from lfref.bench.stability import goals, trials
from lfref.bench.stability.trials import Component
from lfref.captures.correct import correct_by_option
from lfref.cli import config as configs
from lfref.cli import inputs
from lfref.cli.command import command, device_of, log, paths, progress
from lfref.cli.refocusing import fixed_planes
from lfref.data.field_sources import SimulatedSource
from lfref.engines.engine import Run
from lfref.errors import InputError, chosen
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.refocuser.refocuser import Refocuser, name_apart
from lfref.report import accuracy_time, bench_plots, drawing, page, plots, sections, stability_table, tables
from lfref.simulator import sim30
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import RandomScenes, Scenes


class Rounds(NamedTuple):
    """Number of counted rounds, and of warm-up rounds before them."""

    counted: int
    warmup: int

    @property
    def all(self) -> range:
        """Numbers of all rounds, the warm-up first."""
        return range(self.warmup + self.counted)


def configured_rounds(config: DictConfig, counted: str = "repeats") -> Rounds:
    """The configured rounds; `counted` is the key of the counted ones.

    Raises:
        InputError: Not numbers, or too small.
    """
    return Rounds(int(configs.number(config, counted, 1)), int(configs.number(config, "warmup", 0)))


def light_fields(config: DictConfig, refocusers: Sequence[Refocuser] = ()) -> list[LightField]:
    """The light fields of `input`, or simulated ones of the paper's size."""
    if config.input is not None:
        return [inputs.read_field(path, config, refocusers) for path in inputs.find_fields(config).values()]
    source: SimulatedSource = configs.build(config.source)
    return [source.field(index) for index in range(len(source))]


def test_scenes(names: DictConfig | None) -> dict[str, Scene]:
    """Scenes of sim30 by name; None: all thirty.

    Raises:
        InputError: There is no such scene.
    """
    selected = list(sim30.SCENES) if names is None else list(configs.plain(names))
    return {name: chosen("sim30 scene", name, sim30.SCENES) for name in selected}


def write_facts(
    folder: Path,
    device: torch.device,
    fields: Sequence[LightField],
    planes: FocalPlanes,
    counted: int,
    **more: object,
) -> None:
    """Write `machine.json`: machine, libraries, threads, light fields, number of planes and of counted runs."""
    facts = timing.facts(device) | {
        "light_fields": ", ".join(field.name for field in fields),
        "views": ", ".join(sorted({"x".join(map(str, field.views.shape)) for field in fields})),
        "planes": len(planes),
        "repeats": counted,
        **more,
    }
    atomic.write_text(folder / "machine.json", json.dumps(facts, indent=2) + "\n")


# Group `causes`: the cost of each cause of error, and the gain of each remedy.


def causes(config: DictConfig, folder: Path) -> None:
    """Write `causes.csv`, `causes_by_plane.csv`, `causes_by_scene.csv`, `machine.json` and `causes.png`; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=causes`.
        folder: The run folder.
    """
    device, margin = device_of(config.device), int(configs.number(config, "margin", 0))
    grids = tuple(int(n) for n in configs.plain(config.grids))
    plan = CauseSettings(fixed_planes(config), margin, configs.build(config.sensor), grids, device)
    remedies = list(configs.build(config.remedies).values())
    name_apart(remedies)
    scenes = test_scenes(config.judged)
    measured = pd.DataFrame(
        error_causes.rows(progress(list(scenes.values()), "measuring error causes"), remedies, plan)
    )
    by_plane = error_causes.summary(measured, "alpha", "slope")
    written = {"causes": error_causes.summary(measured), "causes_by_plane": by_plane, "causes_by_scene": measured}
    for name, table in written.items():
        tables.write_table(folder / f"{name}.csv", table)
    drawing.save_figure(bench_plots.error_causes(by_plane), folder / "causes.png")
    write_facts(folder, device, [], plan.planes, 1, sim30=sim30.VERSION, scenes=len(scenes), margin=margin)
    log.info("%d causes in %d scenes: %s", measured["cause"].nunique(), len(scenes), folder / "causes.csv")


# Group `engines`: time, memory and accuracy of each runtime of a network on this machine.

PACKAGES = ("onnxruntime", "openvino", "nncf")
Make = Callable[..., NetworkCase]
"""(fields=..., device=...) -> a network and what it is measured on."""


def engines(config: DictConfig, folder: Path) -> None:
    """Write `engines.csv`, `passes.csv`, `machine.json` and `engines.png`; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=engines`.
        folder: The run folder.
    """
    device = device_of(config.device)
    choices = engine_timing.choices(configs.plain(config.engines), configs.plain(config.precisions))
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
    table = engine_timing.summary(passed, starts)
    for name, rows in {"engines": table, "passes": passed}.items():
        tables.write_table(folder / f"{name}.csv", rows)
    drawing.save_figure(bench_plots.engines(table), folder / "engines.png")
    packages = {package: timing.version(package) for package in PACKAGES}
    write_facts(folder, device, fields.whole, fixed_planes(config), max(repeats.values()), passes=repeats, **packages)
    for row in engine_timing.fastest(table).itertuples():
        log.info("%s: %s in %s is %.1f times faster", row.network, row.engine, row.precision, row.ratio_to_eager)
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
    trained, planes = [load(path) for path in paths(configs.plain(config.checkpoint))], fixed_planes(config)
    if not trained:
        torch.manual_seed(0)
        network = configs.build(config.net)
        checkpoint.check_number(network, planes)
        return [functools.partial(engine_timing.network_case, network.name, network, planes=planes, is_trained=False)]
    name_apart(trained)
    return [_trained(each, planes) for each in trained]


def _trained(trained: Refocuser, planes: FocalPlanes) -> Make:
    if not isinstance(trained, NetworkRefocuser):
        remedy = "give refiner_checkpoint=RUN"
        raise InputError("checkpoint must be of a network that reads views", got=trained.name, remedy=remedy)
    its_own, network = trained.planes or planes, trained.network
    return functools.partial(engine_timing.network_case, trained.name, network, planes=its_own, is_trained=True)


def _refiners(config: DictConfig) -> Sequence[Make]:
    """The refiner that ships, or another one."""
    trained = load(config.refiner_checkpoint)
    if not isinstance(trained, RefinedRefocuser):
        remedy = "give checkpoint=RUN"
        raise InputError("refiner_checkpoint must be of a refiner", got=trained.name, remedy=remedy)
    return [functools.partial(engine_timing.refiner_case, trained, planes=fixed_planes(config))]


SUBJECTS: dict[str, Callable[[DictConfig], Sequence[Make]]] = {"network": _networks, "refiner": _refiners}
"""What engines can be measured on."""


def _measured(case: NetworkCase, choices: Sequence[tuple[str, str]], repeats: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """How engines start, and how they pass; what they hold is gone afterwards."""
    runs: dict[tuple[str, str], Run] = {}
    starts: list[Row] = []
    for engine, precision in progress(choices, f"{case.name}: starting engines"):
        row: Row = {"network": case.name, "engine": engine, "precision": precision}
        try:
            made = engine_timing.start(case, engine, precision)
            runs[engine, precision] = made.run
            row |= {"start_s": made.start_s, "extra_bytes": made.extra_bytes}
        except InputError as error:
            log.info("%s %s is left out: %s", engine, precision, error)
            row |= {"skipped": str(error)}
        starts.append(row)
    rounds = progress(range(repeats), f"{case.name}: passes of {len(runs)} engines")
    return pd.DataFrame(starts), pd.DataFrame(engine_timing.passes(case, runs, rounds))


# Group `front`: accuracy against time of every method and checkpoint, evaluated against the truth.

HELD_OUT = 2_000_003
"""Seed of the scenes drawn at random."""
TIMES = ["median_s", "p10_s", "p90_s", "ratio_to_numpy_fft"]


def front(config: DictConfig, folder: Path) -> None:
    """Write `bench.csv`, `scenes.csv`, `planes.csv`, `evaluation.csv`, `machine.json` and two pictures; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=front`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), configured_rounds(config)
    margin = int(configs.number(config, "margin", 0))
    planes = fixed_planes(config)
    methods = _methods(config, device)
    judges, fields = _judges(config, methods, planes, device)
    judged = pd.DataFrame(evaluation.evaluate(judges, methods, planes, margin))
    cases = [MethodCase(method, field) for field in fields for method in methods]
    times = operator_costs.times(cases, planes.slopes, progress(rounds.all, "measuring rounds"), rounds.warmup)
    bench = times[TIMES].reset_index().drop(columns="input").merge(evaluation.by_class(judged), "left", "method")
    by_plane = evaluation.by_plane(judged)
    written = {"bench": bench, "scenes": evaluation.by_scene(judged), "planes": by_plane, "evaluation": judged}
    for name, table in written.items():
        tables.write_table(folder / f"{name}.csv", table)
    drawing.save_figure(accuracy_time.accuracy_time(bench), folder / "accuracy_time.png")
    drawing.save_figure(plots.psnr_by_plane(by_plane), folder / "by_plane.png")
    write_facts(folder, device, fields, planes, rounds.counted, sim30=sim30.VERSION, margin=margin)
    log.info("%d methods on %d scenes: %s", len(methods), judged["scene"].nunique(), folder / "bench.csv")


def _methods(config: DictConfig, device: torch.device) -> list[Refocuser]:
    networks = [load(path, device) for path in paths(configs.plain(config.checkpoint))]
    methods = [*(method.to(device) for method in configs.build(config.methods).values()), *networks]
    name_apart(methods)
    return methods


def _judges(
    config: DictConfig, methods: Sequence[Refocuser], planes: FocalPlanes, device: torch.device
) -> tuple[Iterable[EvaluationCase], list[LightField]]:
    """What the methods are judged on, and what they are timed on: scenes are small, and time has a size of its own."""
    if config.input is None:
        scenes = [*test_scenes(config.judged).values(), *_varied(config)]
        if not scenes:
            raise InputError("there must be scenes to evaluate", got="none", remedy="name some by judged or varied")
        fields = [field.to(device) for field in light_fields(config, methods)]
        chosen("correct", config.correct, CORRECTIONS)
        return evaluation.scene_cases(
            progress(scenes, "judging by truth"), planes.slopes, device, config.correct
        ), fields
    judges = list(_of_captures(config, methods, planes, device))
    return progress(judges, f"evaluating against {judges[0].reference}"), [judge.light for judge in judges]


def _varied(config: DictConfig) -> list[Scene]:
    """Scenes drawn at random; sets of planes are drawn from other seeds, so that no network has seen them."""
    held_out: RandomScenes = configs.build(config.held_out)
    return [held_out.scene(HELD_OUT, 0, index) for index in range(int(configs.number(config, "varied", 0)))]


def _of_captures(
    config: DictConfig, methods: Sequence[Refocuser], planes: FocalPlanes, device: torch.device
) -> Iterator[EvaluationCase]:
    """Light fields that are given, every second or third view of them if that is asked for."""
    read = light_fields(config, methods if config.thin is None else ())
    fields = (
        correct_by_option(field, str(config.correct), even_grid_for=evaluation.EVEN_GRID)[0].to(device)
        for field in read
    )
    if config.thin is None:
        log.info("no truth is known of these light fields: they are judged by exact refocusing of their own views")
        return evaluation.capture_cases(fields, planes.slopes)
    return evaluation.hold_out_cases(fields, int(configs.number(config, "thin", 2)), planes.slopes)


# Group `operators`: time and memory of every operator on one light field, and how time scales.


def time_operators(config: DictConfig, folder: Path) -> None:
    """Write `operators.csv`, `scaling.csv`, `exponents.csv`, `machine.json`, `operators.png` and `scaling.png`.

    Args:
        config: `conf/bench.yaml` with `group=operators`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), configured_rounds(config)
    scale_rounds = configured_rounds(config, "scale_repeats")
    planes = fixed_planes(config)
    scales: Scales = configs.build(config.scales)
    in_numpy: dict[str, str] = configs.plain(config.in_numpy)
    field = _only_field(config).to(device)
    sizes = scales.sizes(Size(field.grid, field.size, len(planes)))
    cases = list(_cases(config, field, set(in_numpy.values())))
    rows = _costs(cases, planes, rounds, in_numpy)
    methods = {case.method.name: case.method for case in cases if case.method.name not in in_numpy.values()}
    timed = progress(list(methods.values()), "measuring growth")
    growth = operator_costs.growth_times(timed, sizes, field.views.shape[2], device, *scale_rounds)
    _write(folder, rows, growth)
    limits = operator_costs.shift_and_sum_limits(field.views, len(planes))
    write_facts(folder, device, [field], planes, rounds.counted, shift_and_sum_limits=limits._asdict())
    log.info("%d operators on %s: %s", len(cases), field.name, folder / "operators.csv")


def _only_field(config: DictConfig) -> LightField:
    fields = light_fields(config)
    if len(fields) != 1:
        raise InputError("this group measures one light field", got=len(fields), remedy="give input=LIGHT_FIELD")
    return fields[0]


def _cases(config: DictConfig, field: LightField, on_cpu: set[str]) -> Iterator[MethodCase]:
    """Every method on the field, as it is and, where asked for, as integers; sample weights are left out."""
    for method in configs.build(config.methods).values():
        views = field.views.cpu() if method.name in on_cpu else field.views
        has_reference = method.name not in config.other_planes
        yield MethodCase(method, views, has_reference)
        if method.name in config.integer_input:
            yield MethodCase(method, operator_costs.as_uint8(views), has_reference)


def _costs(cases: list[MethodCase], planes: FocalPlanes, rounds: Rounds, in_numpy: dict[str, str]) -> pd.DataFrame:
    first = operator_costs.first_calls(progress(cases, "first calls"), planes.slopes)
    times = operator_costs.times(
        cases, planes.slopes, progress(rounds.all, "measuring rounds"), rounds.warmup, in_numpy
    )
    peaks = operator_costs.peaks(progress(cases, "measuring memory"), planes.slopes)
    return operator_costs.operators_table(cases, len(planes), first, times, peaks)


def _write(folder: Path, operators: pd.DataFrame, growth: pd.DataFrame) -> None:
    exponents = operator_costs.growth_exponents(growth)
    for name, table in {"operators": operators, "scaling": growth, "exponents": exponents}.items():
        tables.write_table(folder / f"{name}.csv", table)
    drawing.save_figure(bench_plots.operator_costs(operators), folder / "operators.png")
    drawing.save_figure(bench_plots.growth(growth, exponents), folder / "scaling.png")


# Group `simulate`: time of the simulator by scene and pass, and accuracy of refocused views against the truth.


def simulate(config: DictConfig, folder: Path) -> None:
    """Write `simulate.csv`, `passes.csv`, `rates.csv`, `truth.csv`, `alphas.csv` and their picture; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=simulate`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), configured_rounds(config)
    planes = fixed_planes(config)
    classes, judged = test_scenes(config.classes), test_scenes(config.judged)
    patches: Scenes = configs.build(config.patches)
    n_patches = int(configs.number(config, "n_patches", 1))
    n_workers = torch.get_num_threads() if device.type == "cpu" else 0
    methods = list(configs.build(config.methods).values())
    costs = simulation_cost.costs(
        classes, planes.slopes, device, progress(rounds.all, "measuring rounds"), rounds.warmup
    )
    distances = simulation_cost.distances(progress(list(judged.items()), "photographing"), methods, planes, device)
    by_plane = simulation_cost.by_plane(distances)
    written = {
        "simulate": costs,
        "passes": simulation_cost.passes(classes, planes.slopes, device),
        "rates": simulation_cost.rates(patches, n_patches, planes.slopes, device, n_workers),
        "truth": distances,
        "alphas": by_plane,
    }
    if config.n_points is not None:
        n_points, scenes = int(configs.number(config, "n_points", 1)), progress(list(judged.items()), "brute force")
        written["aperture"] = simulation_cost.aperture_errors(scenes, planes, n_points, device)
    for name, rows in written.items():
        tables.write_table(folder / f"{name}.csv", rows)
    drawing.save_figure(bench_plots.simulation(pd.DataFrame(costs), by_plane), folder / "simulate.png")
    write_facts(folder, device, [], planes, rounds.counted, sim30=sim30.VERSION)
    log.info("%d classes of scenes, %d scenes judged: %s", len(classes), len(judged), folder / "simulate.csv")


# Group `stability`: all hard cases on every component in every precision, beside textbook forms.

PARTS: dict[str, Callable[[], list[Component]]] = {
    "losses": stability_components.image_components,
    "operators": stability_components.operator_components,
    "networks": stability_components.network_components,
    "exported": stability_components.file_components,
    "simulator": list,
}
"""What can be tried; scenes are the simulator's cases, and it is no formulation of tensors."""
SHOWN = ("1 - SSIM", "1 / PSNR", "loss", "PSNR")
"""Components in `stability.png`."""


def stability(config: DictConfig, folder: Path) -> None:
    """Write `stability.csv`, `goals.csv` (all parts only), `stability.png`, `machine.json` and `index.html`.

    Args:
        config: `conf/bench.yaml` with `group=stability`.
        folder: The run folder.
    """
    parts = list(configs.plain(config.parts))
    if not parts:
        raise InputError(f"parts must be some of {', '.join(PARTS)}", got="none")
    components = [component for part in parts for component in chosen("parts", part, PARTS)()]
    # Inputs are small: threads would cost more than they give.
    with goals.threads(1):
        rows = _rows(components, parts)
        tables.write_table(folder / "stability.csv", rows)
        if set(parts) == set(PARTS):
            figures = progress(goals.goals(components, rows), "measuring goals")
            # A figure that is not a number is written as such: an empty cell says that there is none.
            measured = pd.DataFrame([goal.row() for goal in figures], dtype=object)
            tables.write_table(folder / "goals.csv", measured.map(lambda cell: "nan" if cell != cell else cell))
        _show(folder, rows)
    held = sum(row["holds"] == "yes" for row in rows if row["formulation"] == trials.OURS)
    log.info("%d trials, %d of ours hold: %s", len(rows), held, folder / "stability.csv")


def _rows(components: list[Component], parts: list[str]) -> list[Row]:
    rows = list(trials.run_trials(progress(components, "trying hard cases")))
    rows += stability_components.missing_formats() if "exported" in parts else []
    rows += stability_components.simulator_rows() if "simulator" in parts else []
    return rows


def _show(folder: Path, rows: list[Row]) -> None:
    facts = timing.facts(torch.device("cpu"))
    atomic.write_text(folder / "machine.json", json.dumps(facts, indent=2) + "\n")
    shown = [row for row in rows if row["component"] in SHOWN] or rows
    drawing.save_figure(stability_table.heat_map(pd.DataFrame(shown)), folder / "stability.png")
    page.write_page(folder / "index.html", "Hard cases", sections.sections([folder]), facts)


GROUPS: dict[str, Callable[[DictConfig, Path], None]] = {
    "front": front,
    "causes": causes,
    "operators": time_operators,
    "engines": engines,
    "simulate": simulate,
    "stability": stability,
}
"""Each has its options in `conf/group/NAME.yaml`."""


def bench(config: DictConfig, folder: Path) -> None:
    """Measure one group.

    Args:
        config: `conf/bench.yaml`.
        folder: The run folder.
    """
    chosen("group", config.group, GROUPS)(config, folder)


main = command(bench)
