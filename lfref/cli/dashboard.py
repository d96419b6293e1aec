"""`lfref dashboard`: a workspace and a report in Weights & Biases, over what `lfref train` and `lfref eval` log."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import wandb_workspaces.reports.v2 as wr
import wandb_workspaces.workspaces as ws
from omegaconf import DictConfig, OmegaConf

from lfref.cli import config as configs
from lfref.cli import loggers
from lfref.cli.command import command, log
from lfref.cli.steps import fixed_planes
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.losses.composite import TERMS
from lfref.train.callbacks import PICTURE, SKIPPED
from lfref.train.modules import LEARNING_RATE, LOSS, MPSNR_OF_STACK, MSSIM_OF_STACK, plane_names

STEP = "trainer/global_step"
"""Step of the optimiser, which Lightning logs with every value; wandb's own counts calls."""
COLUMNS = 24
"""Width of a report's grid."""


def dashboard(config: DictConfig, folder: Path) -> None:
    """Write `dashboard.json`, and save workspace and report if `save=true`."""
    planes, sweep = fixed_planes(config), config.sweep_name
    place = {"entity": config.entity or "", "project": config.project}
    view = workspace(planes, sweep, config.name, **place)
    # By default, the options of the sweeps that ship, and the learning rate.
    sweeps = map(OmegaConf.load, sorted(configs.directory("sweeps").glob("*.yaml")))
    swept = dict.fromkeys([*(option for each in sweeps for option in each.parameters), "optimizer.lr"])
    page = report(planes, sweep, configs.plain(config.options) or list(swept), title=config.name, **place)
    models = {"workspace": view._to_model(), "report": page._to_model()}
    contents = {
        name: json.loads(model.model_dump_json(by_alias=True, exclude_none=True)) for name, model in models.items()
    }
    atomic.write_text(folder / "dashboard.json", json.dumps(contents, indent=1) + "\n")
    if config.save:
        page.save()  # first: it makes the project if there is none
        view.save()
        log.info("workspace: %s\nreport: %s", view.url, page.url)
    else:
        log.info("specification: %s; save=true saves it in wandb", folder / "dashboard.json")


def workspace(planes: FocalPlanes, sweep: str | None, name: str, entity: str, project: str) -> ws.Workspace:
    """Sections of curves and pictures over the trainings, which are grouped by their sweep."""
    by_plane = plane_names(planes)
    sections: dict[str, list[Any]] = {
        "Quality": [_curve(MPSNR_OF_STACK, "MPSNR, dB"), _curve(MSSIM_OF_STACK, "MSSIM")],
        "By plane": [_bars(planes), _curve(by_plane, "MPSNR of each plane, dB")],
        "Losses": [_curve([f"{stage}/{name}" for stage in ("train", "val")], name) for name in (LOSS, *TERMS)],
        "Learning rate and skipped steps": [
            _curve(LEARNING_RATE, "learning rate", log_y=True),
            _curve(SKIPPED, "skipped steps"),
        ],
        "Worst and best patches": [_pictures([PICTURE], "label, prediction, error")],
    }
    return ws.Workspace(
        entity=entity,
        project=project,
        name=name,
        sections=[ws.Section(name=name, panels=panels, is_open=True) for name, panels in sections.items()],
        settings=ws.WorkspaceSettings(x_axis=STEP, max_runs=100),
        runset_settings=ws.RunsetSettings(filters=_filters("train", sweep), groupby=[ws.Metric("Group")]),
    )


def report(planes: FocalPlanes, sweep: str | None, options: Sequence[str], **place: str) -> wr.Report:
    """A page on a sweep: curves, which options matter, quality by plane, pictures, tables of evaluations."""
    columns = [wr.ParallelCoordinatesPlotColumn(wr.Config(option)) for option in options]
    target = wr.ParallelCoordinatesPlotColumn(wr.SummaryMetric(MPSNR_OF_STACK), display_name="MPSNR, dB")

    def runs(job: str, groups: Sequence[str] = ()) -> wr.Runset:
        own = sweep if job == "train" else None  # evaluations belong to no sweep
        return wr.Runset(project=place["project"], name=job, filters=_filters(job, own), groupby=list(groups))

    trained = runs("train", ["group"])
    blocks: list[Any] = [
        wr.H1("Validation"),
        _grid(trained, [_curve(MPSNR_OF_STACK, "MPSNR, dB"), _curve(MSSIM_OF_STACK, "MSSIM")]),
        wr.H1("Which options matter"),
        _grid(
            runs("train"),
            [
                wr.ParameterImportancePlot(with_respect_to=MPSNR_OF_STACK),
                wr.ParallelCoordinatesPlot(columns=[*columns, target], title="options and MPSNR"),
            ],
        ),
        wr.H1("Planes and patches"),
        _grid(trained, [_bars(planes), _pictures([PICTURE], "worst and best patch")]),
        wr.H1("Evaluations"),
        _grid(
            runs("eval"),
            [
                *(wr.WeavePanelSummaryTable(table_name=name) for name in (loggers.SUMMARY, loggers.PLANES)),
                *(_pictures([name], name) for name in (loggers.SCATTER, loggers.QUALITY_BY_PLANE, loggers.COMPARISON)),
            ],
        ),
    ]
    return wr.Report(**place, blocks=blocks, width="fluid")


def _filters(job: str, sweep: str | None) -> list[Any]:
    return [ws.Metric("JobType") == job, *([] if sweep is None else [ws.Metric("Group") == sweep])]


def _curve(names: str | list[str], title: str, **options: Any) -> wr.LinePlot:
    """A plot over the steps. Of a group of runs it shows the mean, and the range as a band."""
    y: list[Any] = [names] if isinstance(names, str) else [*names]
    return wr.LinePlot(title=title, x=STEP, y=y, groupby_aggfunc="mean", groupby_rangefunc="minmax", **options)


def _bars(planes: FocalPlanes) -> wr.BarPlot:
    names: list[Any] = list(plane_names(planes))
    return wr.BarPlot(title="MPSNR of each plane, dB", metrics=names, orientation="v", max_bars_to_show=len(names))


def _pictures(names: list[str], title: str) -> wr.MediaBrowser:
    return wr.MediaBrowser(title=title, media_keys=names, num_columns=2)


def _grid(runs: wr.Runset, panels: list[Any]) -> wr.PanelGrid:
    """Panels in rows of two."""
    for index, panel in enumerate(panels):
        row, column = divmod(index, 2)
        panel.layout = wr.Layout(x=column * COLUMNS // 2, y=row * 10, w=COLUMNS // 2, h=10)
    return wr.PanelGrid(runsets=[runs], panels=panels)


run = command(dashboard)
