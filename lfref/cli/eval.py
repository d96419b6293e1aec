"""`lfref eval`: evaluate checkpoints and operators plane by plane, and draw the paper's two figures."""

import functools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig
from torch import Tensor

from lfref.bench import accuracy, timing
from lfref.cli import config as configs
from lfref.cli import shards, steps
from lfref.cli.command import command, device_of, log, paths, progress
from lfref.cli.steps import fixed_planes
from lfref.data.label_sources import Labels
from lfref.errors import InputError, counted
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser, name_apart
from lfref.report import answers, comparison, crops, drawing, pictures, plots, tables
from lfref.report.answers import Answer


def evaluate(config: DictConfig, folder: Path) -> None:
    """Write `planes.csv`, `summary.csv`, `machine.json`, two plots, and one comparison per light field.

    Loggers get the tables and the pictures too.
    """
    device = device_of(config.device)
    planes = fixed_planes(config)
    references: dict[str, Labels] = configs.build(config.references)
    methods = _methods(config, device)
    for method in methods:
        method.slopes(planes.slopes)  # a network refuses planes that are not its own, before any work is done
    found = steps.find_fields(config)
    fields = {name: found[name] for name in shards.share_of(list(found), config.shard)}
    rows: list[accuracy.Row] = []
    places: dict[str, Path] = {}
    with _logging(config) as log_evaluation:
        for path in progress(fields.values(), "evaluating", len(fields)):
            field = steps.read_field(path, config, methods)
            with torch.no_grad():
                stacks = {method.name: method(field.to(device), planes.slopes).cpu() for method in methods}
            labels = {name: source(field) for name, source in references.items()}
            places[field.name] = path
            rows += accuracy.plane_rows(field.name, stacks, labels, planes)
            shown = stacks | {f"label: {name}": label for name, label in labels.items()}
            figure = comparison.comparison(shown, planes, field.views.mean(dim=(0, 1)))
            drawing.save_figure(figure, folder / "comparison" / f"{field.name}.png")
        table = pd.DataFrame(rows)
        summary = accuracy.summaries(table)
        summary["is_network"] = summary["method"].isin([method.name for method in methods if method.is_network])
        tables.write_table(folder / "planes.csv", table)
        tables.write_table(folder / "summary.csv", summary)
        atomic.write_text(folder / "machine.json", json.dumps(timing.facts(device), indent=2) + "\n")
        if not tables.judged_by_others(summary).empty:
            if len(fields) > 1:  # of one light field the table says all
                drawing.save_figure(plots.scatter(summary), folder / "scatter.png")
            drawing.save_figure(plots.quality_by_plane(table), folder / "quality_by_plane.png")
        log_evaluation(summary, table, folder)
    if (answer := answers.of_evaluation(summary)) is not None:
        worst = steps.read_field(places[answer.worst], config, methods).to(device)
        _write_crops(folder, worst, methods, references, planes, answer)
        log.info(answer.sentence)
    log.info("%s, %s: %s", counted(len(fields), "light field"), counted(len(methods), "method"), folder / "summary.csv")


@contextmanager
def _logging(config: DictConfig) -> Iterator[Callable[[pd.DataFrame, pd.DataFrame, Path], None]]:
    """Start the loggers before the work; yields the function that gives them summary, planes, and the run folder."""
    if not config.get("logger"):
        yield lambda summary, table, folder: None
        return
    from lfref.cli import loggers  # imported here: Lightning and wandb take seconds

    with loggers.running(config, "eval", without=("csv",)) as running:  # the tables are CSV files already
        yield functools.partial(loggers.log_evaluation, running)


def _methods(config: DictConfig, device: torch.device) -> list[Refocuser]:
    networks = [load(path, device) for path in paths(configs.plain(config.checkpoint))]
    methods = [*networks, *(method.to(device) for method in configs.build(config.methods).values())]
    name_apart(methods)
    if not methods:
        raise InputError(
            "there must be something to evaluate", remedy="give checkpoint=PATH or +method@methods.NAME=NAME"
        )
    return methods


@torch.no_grad()
def _write_crops(
    folder: Path,
    field: LightField,
    methods: Sequence[Refocuser],
    references: Mapping[str, Labels],
    planes: FocalPlanes,
    answer: Answer,
) -> None:
    """Write the crops of the plane where our method is worst, all with the exposure of the comparison."""
    label = references[answer.reference](field).cpu()
    stacks = {
        method.name: method(field, planes.slopes).cpu()
        for method in methods
        if method.name in (answer.ours, answer.other)
    }
    plane = int(psnr(stacks[answer.ours], label).argmin())
    exposure = pictures.common_exposure(field.views.mean(dim=(0, 1)))

    def shown(picture: Tensor) -> Tensor:
        return torch.tensor(pictures.for_display(picture, exposure)).permute(2, 0, 1)

    rows, columns = field.grid
    other = None if answer.other is None else shown(stacks[answer.other][plane])
    view = shown(field.views[rows // 2, columns // 2])
    crops.write(folder, view, shown(stacks[answer.ours][plane]), other, shown(label[plane]))


main = command(evaluate)

if __name__ == "__main__":
    main()
