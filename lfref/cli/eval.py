"""`lfref eval`: judge checkpoints and operators plane by plane, and draw the paper's two figures."""

from pathlib import Path

import torch
from omegaconf import DictConfig
from torch import Tensor

from lfref.bench import accuracy, methods
from lfref.bench.methods import Method
from lfref.cli import config as configs
from lfref.cli.command import command, device_of, log, paths, progress
from lfref.data.labels import Labels
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.report import drawing, pictures, plots, tables


def evaluate(config: DictConfig, folder: Path) -> None:
    """Write `planes.csv`, `summary.csv`, `scatter.png`, `quality_by_plane.png` and a comparison a light field.

    Args:
        config: `conf/eval.yaml`.
        folder: The run folder.
    """
    device = device_of(config.device)
    planes: FocalPlanes = configs.build(config.planes)
    references: dict[str, Labels] = configs.build(config.references)
    judged = _judged(config, device, planes)
    found = [path for entry in paths(config.input) for path in reader.find(entry)]
    rows: list[accuracy.Row] = []
    for path in progress(found, "evaluating"):
        field = reader.read(path, **configs.plain(config.reader))
        stacks = {method.name: _stack(method, field, planes, device) for method in judged}
        labels = {name: source(field) for name, source in references.items()}
        rows += accuracy.plane_rows(field.name, stacks, labels, planes)
        shown = stacks | {f"label: {name}": label for name, label in labels.items()}
        figure = pictures.comparison(shown, planes.alphas, field.views.mean(dim=(0, 1)))
        drawing.save_figure(figure, folder / "comparison" / f"{field.name}.png")
    summary = accuracy.summaries(rows)
    tables.write_table(folder / "planes.csv", rows)
    tables.write_table(folder / "summary.csv", summary)
    drawing.save_figure(plots.scatter(summary), folder / "scatter.png")
    drawing.save_figure(plots.quality_by_plane(rows), folder / "quality_by_plane.png")
    log.info("%d light fields, %d methods: %s", len(found), len(judged), folder / "summary.csv")


def _judged(config: DictConfig, device: torch.device, planes: FocalPlanes) -> list[Method]:
    networks = [methods.network(path, device) for path in paths(configs.plain(config.checkpoint))]
    for network in networks:
        if network.planes != planes:
            raise InputError(
                f"{network.name} must be trained for the planes that are evaluated",
                got=network.planes,
                remedy="give the same planes=... as in training",
            )
    operators = methods.operators({entry.name: configs.build(entry.operator) for entry in config.methods.values()})
    judged = methods.unique_names(networks + operators)
    if not judged:
        raise InputError(
            "there must be something to evaluate", remedy="give checkpoint=PATH or +method@methods.NAME=NAME"
        )
    return judged


@torch.no_grad()
def _stack(method: Method, field: LightField, planes: FocalPlanes, device: torch.device) -> Tensor:
    return method.stack(field.to(device), planes.slopes).cpu()


main = command(evaluate)

if __name__ == "__main__":
    main()
