"""Group `front`: accuracy against time of every operator setting and every checkpoint, judged by truth."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig

from lfref.bench import cost, judging, subjects
from lfref.bench.cost import Case
from lfref.bench.subjects import Subject
from lfref.cli import config as configs
from lfref.cli.benches import shared
from lfref.cli.command import device_of, log, paths, progress
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocuser.networks import load
from lfref.refocuser.refocuser import Refocuser, name_apart
from lfref.report import drawing, plots, tables
from lfref.report import front as picture
from lfref.simulator import sim30

TIMES = ["median_s", "p10_s", "p90_s", "ratio_to_numpy_fft"]


def front(config: DictConfig, folder: Path) -> None:
    """Write `bench.csv`, `scenes.csv`, `planes.csv`, `judged.csv`, `machine.json` and two pictures; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=front`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), shared.rounds(config)
    margin = int(configs.number(config, "margin", 0))
    planes: FocalPlanes = configs.build(config.planes)
    methods = _methods(config, device)
    fields = [field.to(device) for field in shared.light_fields(config, methods)]
    judged = pd.DataFrame(judging.rows(_subjects(config, fields, planes, device), methods, planes, margin))
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
    methods = [*configs.build(config.methods).values(), *networks]
    name_apart(methods)
    return methods


def _subjects(
    config: DictConfig, fields: Sequence[LightField], planes: FocalPlanes, device: torch.device
) -> Iterator[Subject]:
    """The light fields given, or scenes whose truth is known."""
    if config.input is None:
        scenes = shared.scenes(config.judged)
        return subjects.simulated(progress(scenes.values(), "judging by truth"), planes.slopes, device)
    log.info("no truth is known of these light fields: they are judged by exact refocusing of their own views")
    return subjects.given(progress(fields, "judging by exact refocusing"), planes.slopes)
