"""Group `front`: accuracy against time of every operator setting and every checkpoint, judged by truth."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig

from lfref.bench import cost, judging, subjects, thinning
from lfref.bench.cost import Case
from lfref.bench.subjects import CORRECTIONS, Subject
from lfref.captures.asked import as_asked
from lfref.cli import config as configs
from lfref.cli.benches import shared
from lfref.cli.command import device_of, log, paths, progress
from lfref.cli.planes import fixed
from lfref.errors import InputError, chosen
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser, name_apart
from lfref.report import drawing, plots, tables
from lfref.report import front as picture
from lfref.simulator import sim30
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import RandomScenes

HELD_OUT = 2_000_003
"""Seed of the scenes drawn at random."""
TIMES = ["median_s", "p10_s", "p90_s", "ratio_to_numpy_fft"]


def front(config: DictConfig, folder: Path) -> None:
    """Write `bench.csv`, `scenes.csv`, `planes.csv`, `judged.csv`, `machine.json` and two pictures; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=front`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), shared.rounds(config)
    margin = int(configs.number(config, "margin", 0))
    planes = fixed(config)
    methods = _methods(config, device)
    judges, fields = _judges(config, methods, planes, device)
    judged = pd.DataFrame(judging.rows(judges, methods, planes, margin))
    cases = [Case(method, field) for field in fields for method in methods]
    times = cost.times(cases, planes.slopes, progress(rounds.all, "measuring rounds"), rounds.warmup)
    bench = times[TIMES].reset_index().drop(columns="input").merge(judging.by_class(judged), "left", "method")
    by_plane = judging.by_plane(judged)
    written = {"bench": bench, "scenes": judging.by_scene(judged), "planes": by_plane, "judged": judged}
    for name, table in written.items():
        tables.write_table(folder / f"{name}.csv", table)
    drawing.save_figure(picture.accuracy_time(bench), folder / "accuracy_time.png")
    drawing.save_figure(plots.psnr_by_plane(by_plane), folder / "by_plane.png")
    shared.write_facts(folder, device, fields, planes, rounds.counted, sim30=sim30.VERSION, margin=margin)
    log.info("%d methods on %d scenes: %s", len(methods), judged["scene"].nunique(), folder / "bench.csv")


def _methods(config: DictConfig, device: torch.device) -> list[Refocuser]:
    networks = [load(path, device) for path in paths(configs.plain(config.checkpoint))]
    methods = [*(method.to(device) for method in configs.build(config.methods).values()), *networks]
    name_apart(methods)
    return methods


def _judges(
    config: DictConfig, methods: Sequence[Refocuser], planes: FocalPlanes, device: torch.device
) -> tuple[Iterable[Subject], list[LightField]]:
    """What the methods are judged on, and what they are timed on: scenes are small, and time has a size of its own."""
    if config.input is None:
        scenes = [*shared.scenes(config.judged).values(), *_varied(config)]
        if not scenes:
            raise InputError("there must be scenes to judge by", got="none", remedy="name some by judged or varied")
        fields = [field.to(device) for field in shared.light_fields(config, methods)]
        chosen("correct", config.correct, CORRECTIONS)
        return subjects.simulated(progress(scenes, "judging by truth"), planes.slopes, device, config.correct), fields
    judges = list(_of_captures(config, methods, planes, device))
    return progress(judges, f"judging by {judges[0].reference}"), [judge.light for judge in judges]


def _varied(config: DictConfig) -> list[Scene]:
    """Scenes drawn at random; sets of planes are drawn from other seeds, so that no network has seen them."""
    held_out: RandomScenes = configs.build(config.held_out)
    return [held_out.scene(HELD_OUT, 0, index) for index in range(int(configs.number(config, "varied", 0)))]


def _of_captures(
    config: DictConfig, methods: Sequence[Refocuser], planes: FocalPlanes, device: torch.device
) -> Iterator[Subject]:
    """Light fields that are given, every second or third view of them if that is asked for."""
    read = shared.light_fields(config, methods if config.thin is None else ())
    even = "methods are compared on an even grid"
    fields = (as_asked(field, str(config.correct), even=even)[0].to(device) for field in read)
    if config.thin is None:
        log.info("no truth is known of these light fields: they are judged by exact refocusing of their own views")
        return subjects.given(fields, planes.slopes)
    return thinning.thinned(fields, int(configs.number(config, "thin", 2)), planes.slopes)
