"""`lfref eval`: evaluate checkpoints and operators plane by plane, and draw the paper's two figures."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig
from torch import Tensor

from lfref.bench import accuracy, timing
from lfref.bench.evaluation import TRUTH
from lfref.cli import steps
from lfref.cli.command import command, device_of, log
from lfref.cli.steps import fixed_planes
from lfref.data.labels import OperatorLabels
from lfref.errors import LfrefError, counted
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser
from lfref.report import answers, drawing, pictures, plots, tables
from lfref.report.answers import Answer
from lfref.report.refocused import mean_of_views

PLANES = "planes.csv"
"""Scores of every plane; a run that goes on leaves out the light fields in this table."""


def evaluate(config: DictConfig, folder: Path) -> None:
    """Write `planes.csv`, `summary.csv`, `machine.json`, two plots, a comparison per light field, and to loggers."""
    device = device_of(config.device)
    methods = steps.compared_methods(config, device)
    planes = fixed_planes(config, methods)
    references: dict[str, OperatorLabels] = {
        name: dataclasses.replace(labels, planes=planes) for name, labels in steps.parts_of(config.references).items()
    }
    for method in methods:
        method.slopes(planes.slopes)  # a network refuses planes that are not its own, before any work is done
    fields = steps.find_fields(config)
    goes_on = config.resume is not None and (folder / PLANES).is_file()
    rows: list[accuracy.Row] = tables.read_table(folder / PLANES).to_dict("records") if goes_on else []
    done = {row["light_field"] for row in rows}

    def read(_: str, path: Path) -> LightField:
        return steps.read_field(path, config, methods)

    def labels_of(name: str, field: LightField) -> dict[str, Tensor]:
        labels = {reference: source(field).cpu() for reference, source in references.items()}
        if config.truth is not None:
            labels[TRUTH] = steps.checked_truth(steps.read_truth(config.truth, name, len(fields)), field, planes)
        return labels

    def compute(name: str, field: LightField) -> tuple[LightField, dict[str, Tensor], dict[str, Tensor]]:
        stacks = {method.name: steps.refocus_field(method, field, planes.slopes, device) for method in methods}
        return field, stacks, labels_of(name, field)

    def write(name: str, result: tuple[LightField, dict[str, Tensor], dict[str, Tensor]]) -> None:
        field, stacks, labels = result
        shown = stacks | {f"label: {label}": stack for label, stack in labels.items()}
        figure = plots.comparison(shown, planes, mean_of_views(field))
        drawing.save_figure(figure, folder / "comparison" / f"{name}.png")
        # Rows are written after the picture, so that a killed run leaves no light field in the table without one.
        rows.extend(accuracy.plane_rows(name, stacks, labels, planes))
        tables.write_table(folder / PLANES, rows)

    failure: LfrefError | None = None
    remaining = {name: path for name, path in fields.items() if name not in done}
    try:
        steps.process(remaining, [read, compute, write], "evaluating")
    except LfrefError as error:
        if not rows:
            raise
        failure = error  # raised after the table of the others
    table = pd.DataFrame(rows)
    summary = accuracy.summaries(table)
    summary["is_network"] = summary["method"].isin([method.name for method in methods if method.is_network])
    tables.write_table(folder / "summary.csv", summary)
    timing.write_facts(folder, device)
    if not tables.judged_by_others(summary).empty:
        if summary["light_field"].nunique() > 1:  # of one light field the table says all
            drawing.save_figure(plots.scatter(summary), folder / "scatter.png")
        drawing.save_figure(plots.by_plane(table, ("psnr_db", "ssim")), folder / "quality_by_plane.png")
    if config.get("logger"):
        from lfref.cli import loggers  # imported here: Lightning and wandb take seconds

        loggers.log_evaluation(loggers.started(config, "eval"), summary, table, folder)
    if (answer := answers.of_evaluation(summary, table)) is not None:
        worst = steps.read_field(fields[answer.worst], config, methods)
        label = labels_of(answer.worst, worst)[answer.reference]
        _write_crops(folder, worst.to(device), methods, label, planes, answer)
        log.info(answer.sentence)
    n_fields = counted(summary["light_field"].nunique(), "light field")
    log.info("%s, %s: %s", n_fields, counted(len(methods), "method"), folder / "summary.csv")
    if failure is not None:
        raise failure


@torch.no_grad()
def _write_crops(
    folder: Path,
    field: LightField,
    methods: Sequence[Refocuser],
    label: Tensor,
    planes: FocalPlanes,
    answer: Answer,
) -> None:
    """Write the crops of the plane where our method is worst, all with the exposure of the comparison."""
    stacks = {
        method.name: method(field, planes.slopes).cpu()
        for method in methods
        if method.name in (answer.ours, answer.other)
    }
    plane = int(psnr(stacks[answer.ours], label).argmin())
    exposure = pictures.common_exposure(mean_of_views(field))

    def shown(picture: Tensor) -> Tensor:
        return torch.tensor(pictures.for_display(picture, exposure)).permute(2, 0, 1)

    rows, columns = field.grid
    other = None if answer.other is None else shown(stacks[answer.other][plane])
    view = shown(field.views[rows // 2, columns // 2])
    answers.write_crops(folder, view, shown(stacks[answer.ours][plane]), other, shown(label[plane]))


run = command(evaluate)
