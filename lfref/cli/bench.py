"""`lfref bench`: measurements; `suite=NAME` selects one function of `SUITES`."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig

from lfref.bench import accuracy, causes, costs, evaluation, timing
from lfref.bench.causes import CauseSettings
from lfref.bench.costs import Scales, Size
from lfref.bench.evaluation import CORRECTIONS, EvaluationCase
from lfref.bench.stability import trials
from lfref.bench.stability.trials import Component
from lfref.captures.correct import correct
from lfref.cli import config as configs
from lfref.cli import steps
from lfref.cli.command import command, device_of, log, progress
from lfref.cli.steps import fixed_planes
from lfref.data.datamodules import SimulatedSource
from lfref.errors import InputError, chosen, counted
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser, name_apart
from lfref.report import answers, drawing, page, plots, sections, tables
from lfref.report.answers import Answer
from lfref.simulator import sim30
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import RandomScenes


def light_fields(config: DictConfig, refocusers: Sequence[Refocuser] = ()) -> list[LightField]:
    """The light fields of `input`, or simulated ones of the paper's size."""
    if config.input is not None:
        found = steps.find_fields(config).items()
        return [dataclasses.replace(steps.read_field(path, config, refocusers), name=name) for name, path in found]
    source: SimulatedSource = configs.build(config.source)
    return [source.light(index) for index in range(len(source))]


def test_scenes(names: DictConfig | None, version: str) -> dict[str, Scene]:
    """Scenes of a version of sim30 by name; None: all thirty."""
    scenes = sim30.VERSIONS[version]
    selected = list(scenes) if names is None else list(configs.plain(names))
    return {name: chosen("sim30 scene", name, scenes) for name in selected}


def _rounds(config: DictConfig) -> Iterable[int]:
    """The rounds of all methods, those of the warm-up first."""
    return progress(range(config.warmup + config.repeats), "measuring rounds")


def write_facts(
    folder: Path,
    device: torch.device,
    fields: Sequence[LightField],
    planes: FocalPlanes,
    counted: int,
    **more: object,
) -> None:
    """Write `machine.json`: the machine, light fields, number of planes and of counted runs."""
    timing.write_facts(
        folder,
        device,
        light_fields=", ".join(field.name for field in fields),
        views=", ".join(sorted({"x".join(map(str, field.views.shape)) for field in fields})),
        planes=len(planes),
        repeats=counted,
        **more,
    )


# Group `causes`: the cost of each cause of error, and the gain of each remedy.


def error_causes(config: DictConfig, folder: Path) -> None:
    """Write `causes.csv`, `causes_by_plane.csv`, `causes_by_scene.csv`, `machine.json` and `causes.png`."""
    device, margin, grids = device_of(config.device), config.margin, tuple(config.grids)
    plan = CauseSettings(fixed_planes(config), margin, configs.build(config.sensor), grids, device)
    remedies = list(steps.parts_of(config.remedies).values())
    name_apart(remedies)
    scenes = test_scenes(config.test_scenes, "1")
    measured = pd.DataFrame(causes.rows(progress(list(scenes.values()), "measuring error causes"), remedies, plan))
    by_plane = causes.summary(measured, "alpha", "slope")
    written = {"causes": causes.summary(measured), "causes_by_plane": by_plane, "causes_by_scene": measured}
    for name, table in written.items():
        tables.write_table(folder / f"{name}.csv", table)
    drawing.save_figure(plots.error_causes(by_plane), folder / "causes.png")
    write_facts(folder, device, [], plan.planes, 1, sim30=sim30.VERSION, scenes=len(scenes), margin=margin)
    n_causes = measured["cause"].nunique()
    log.info("%s in %s: %s", counted(n_causes, "cause"), counted(len(scenes), "scene"), folder / "causes.csv")


# Group `front`: accuracy against time of every method and checkpoint, evaluated against the truth.

HELD_OUT = 2_000_003


def front(config: DictConfig, folder: Path) -> None:
    """Write `bench.csv`, `scenes.csv`, `planes.csv`, `evaluation.csv`, `machine.json`, two plots and five crops."""
    device, margin, planes = device_of(config.device), config.margin, fixed_planes(config)
    methods = steps.compared_methods(config, device)
    cases: Iterable[EvaluationCase]
    captures = [] if config.input is None else _capture_cases(config, methods, planes, device)
    if config.input is None:
        cases = _scene_cases(config, planes, device)
        # Scenes are too small for times.
        fields = [field.to(device) for field in light_fields(config, methods)]
    else:
        cases = progress(captures, f"evaluating against {captures[0].reference_name}")
        fields = [case.light for case in captures]
    evaluated = pd.DataFrame(evaluation.evaluate(cases, methods, planes, margin))
    times = costs.times(methods, fields, planes.slopes, _rounds(config), config.warmup)
    bench = times.merge(evaluation.by_class(evaluated), "left", "method")
    bench["is_network"] = bench["method"].isin([method.name for method in methods if method.is_network])
    by_plane, scenes = evaluation.by_plane(evaluated), evaluation.by_scene(evaluated)
    written = {"bench": bench, "scenes": scenes, "planes": by_plane, "evaluation": evaluated}
    for name, table in written.items():
        if len(table):  # scenes of wide baselines have no planes in common
            tables.write_table(folder / f"{name}.csv", table)
    write_facts(
        folder, device, fields, planes, config.repeats, sim30=sim30.VERSION, aliased=sim30.VERSION_2, margin=margin
    )
    if plots.has_front(bench):
        drawing.save_figure(plots.front(bench), folder / "accuracy_time.png")
    if not tables.judged_by_others(by_plane).empty:
        drawing.save_figure(plots.by_plane(by_plane), folder / "by_plane.png")
    if (answer := answers.of_bench(bench, scenes)) is not None:
        again = captures or _scene_cases(config, planes, device, answer.worst)
        case = next(case for case in again if (case.kind, case.light.name) == (answer.kind, answer.worst))
        _write_crops(folder, case, {method.name: method for method in methods}, answer, case.planes or planes, margin)
        log.info(answer.sentence)
    n_scenes = evaluated["scene"].nunique()
    log.info("%s on %s: %s", counted(len(methods), "method"), counted(n_scenes, "scene"), folder / "bench.csv")


def _scene_cases(
    config: DictConfig, planes: FocalPlanes, device: torch.device, only: str | None = None
) -> Iterator[EvaluationCase]:
    """The cases of all scenes, or of the scene of this name; they are rendered when they are asked for."""
    # Trainings draw from other seeds: no network has been trained on these scenes.
    held_out: RandomScenes = configs.build(config.held_out)
    varied = [held_out.scene(HELD_OUT, 0, index) for index in range(config.varied)]
    common = [*test_scenes(config.test_scenes, "1").values(), *varied]
    aliased = list(test_scenes(config.test_scenes, "2").values()) if config.aliased else []
    wide = list(sim30.WIDE.values()) if config.wide else []
    chosen("correct", config.correct, dict.fromkeys(CORRECTIONS))

    def shown(scenes: list[Scene], text: str) -> Iterable[Scene]:
        return progress(scenes, text) if only is None else [scene for scene in scenes if scene.name == only]

    return itertools.chain(
        evaluation.scene_cases(shown(common, "evaluating against the truth"), planes.slopes, device, config.correct),
        (
            evaluation.ideal_case(scene, planes.slopes, device, evaluation.ALIASED)
            for scene in shown(aliased, "evaluating aliased scenes")
        ),
        evaluation.wide_cases(shown(wide, "evaluating wide baselines"), device),
    )


def _capture_cases(
    config: DictConfig, methods: Sequence[Refocuser], planes: FocalPlanes, device: torch.device
) -> list[EvaluationCase]:
    """The cases of the light fields of `input`."""
    corrected = (
        correct(field, str(config.correct), even_grid_for=evaluation.EVEN_GRID)[0].to(device)
        for field in light_fields(config, methods if config.angular_stride is None else ())
    )
    if config.truth is not None:
        cases, names = [], list(steps.find_fields(config))
        for name, field in zip(names, corrected, strict=True):
            stack = steps.checked_truth(steps.read_truth(config.truth, name, len(names)), field, planes)
            cases.append(EvaluationCase(evaluation.GIVEN, field, stack, evaluation.TRUTH))
        return cases
    if config.angular_stride is None:
        log.info("no truth is known of these light fields: the reference is exact refocusing of their own views")
        exact = ((field, accuracy.EXACT(field, planes.slopes)) for field in corrected)
        return [EvaluationCase(evaluation.CAPTURE, *pair, accuracy.EXACT.name) for pair in exact]
    # Methods get every second or third view, the others are the reference.
    return list(evaluation.hold_out_cases(corrected, config.angular_stride, planes.slopes))


@torch.no_grad()
def _write_crops(
    folder: Path,
    case: EvaluationCase,
    methods: Mapping[str, Refocuser],
    answer: Answer,
    planes: FocalPlanes,
    margin: int,
) -> None:
    """Write the crops of the plane where our method is worst."""
    reference = case.displayed(case.reference).encoded

    def stack(name: str) -> torch.Tensor:
        return case.displayed(case.stack(methods[name], planes.slopes)).encoded

    ours = stack(answer.ours)
    plane = int(psnr(accuracy.without_border(ours, margin), accuracy.without_border(reference, margin)).argmin())
    other = None if answer.other is None else stack(answer.other)[plane]
    rows, columns = case.light.grid
    view = case.displayed(case.light.views[rows // 2, columns // 2][None]).encoded[0]
    answers.write_crops(folder, view, ours[plane], other, reference[plane], margin)


# Group `operators`: time and memory of every operator on one light field, and how time scales.


def time_operators(config: DictConfig, folder: Path) -> None:
    """Write `operators.csv`, `scaling.csv`, `exponents.csv` and `machine.json`."""
    device, planes = device_of(config.device), fixed_planes(config)
    scales: Scales = configs.build(config.scales)
    fields = light_fields(config)
    if len(fields) != 1:
        raise InputError("this suite measures one light field", got=len(fields), remedy="give input=LIGHT_FIELD")
    field = fields[0].to(device)
    sizes = scales.sizes(Size(field.grid, field.size, len(planes)))
    methods = list(steps.parts_of(config.methods).values())
    operators = costs.times(methods, [field], planes.slopes, _rounds(config), config.warmup)
    growing, channels = progress(methods, "measuring growth"), field.views.shape[2]
    growth = costs.growth_times(growing, sizes, channels, device, config.scale_repeats, config.warmup)
    exponents = costs.growth_exponents(growth)
    for name, table in {"operators": operators, "scaling": growth, "exponents": exponents}.items():
        tables.write_table(folder / f"{name}.csv", table)
    write_facts(folder, device, [field], planes, config.repeats)
    log.info("%s on %s: %s", counted(len(methods), "operator"), field.name, folder / "operators.csv")


# Group `stability`: all hard cases on every component in every precision, beside textbook forms.

PARTS: dict[str, Callable[[], list[Component]]] = {
    "losses": trials.image_components,
    "operators": trials.operator_components,
    "networks": trials.network_components,
}
SHOWN = ("1 - SSIM", "1 / PSNR", "loss", "PSNR")


def stability(config: DictConfig, folder: Path) -> None:
    """Write `stability.csv`, `stability.png`, `machine.json` and `index.html`."""
    components = [component for part in config.parts for component in chosen("parts", part, PARTS)()]
    n_threads = torch.get_num_threads()
    torch.set_num_threads(1)  # inputs are small: threads would cost more than they give
    rows = list(trials.run_trials(progress(components, "trying hard cases")))
    torch.set_num_threads(n_threads)
    tables.write_table(folder / "stability.csv", rows)
    n_held = sum(row["outcome"] == "holds" for row in rows if row["formulation"] == trials.OURS)
    timing.write_facts(folder, torch.device("cpu"))
    shown = [row for row in rows if row["component"] in SHOWN] or rows
    drawing.save_figure(plots.heat_map(pd.DataFrame(shown)), folder / "stability.png")
    page.write_page(folder / "index.html", "Hard cases", sections.sections([folder]), timing.facts(torch.device("cpu")))
    log.info("%s, %d of ours hold: %s", counted(len(rows), "trial"), n_held, folder / "stability.csv")


SUITES: dict[str, Callable[[DictConfig, Path], None]] = {
    "front": front,
    "causes": error_causes,
    "operators": time_operators,
    "stability": stability,
}
"""Name of a suite -> its function; its options are in `conf/suite/NAME.yaml`."""


def bench(config: DictConfig, folder: Path) -> None:
    """Measure one suite."""
    chosen("suite", config.suite, SUITES)(config, folder)


run = command(bench)
