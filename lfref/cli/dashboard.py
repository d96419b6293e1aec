"""`lfref dashboard`: a workspace and a report in Weights & Biases, over what `lfref train` and `lfref eval` log.

The dashboard is code: panels take the names of metrics from where they are logged, and `dashboard.json` holds the whole
specification as the app stores it. wandb-workspaces draws nothing itself.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import wandb
import wandb_workspaces.reports.v2 as wr
import wandb_workspaces.workspaces as ws
from omegaconf import DictConfig, OmegaConf

from lfref.cli import config as configs
from lfref.cli import loggers
from lfref.cli.command import command, log
from lfref.cli.steps import fixed_planes
from lfref.errors import InputError, first_line
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.losses.composite import TERMS
from lfref.train.callbacks import COUNTS, LEARNING_RATE, PATCHES_PER_SECOND, PICTURE
from lfref.train.modules import LOSS, MPSNR_OF_STACK, MSSIM_OF_STACK, plane_names

SPECIFICATION = "dashboard.json"
STEP = "trainer/global_step"
"""Step of the optimiser, which Lightning logs with every value; wandb's own counts calls."""
LEARNING_RATE_OPTION = "optimizer.lr"
OPTION = re.compile(r"\w+(\.\w+)*")
COLUMNS = 24
"""Width of a report's grid."""


class Dashboard(NamedTuple):
    """What is shown, and of which runs."""

    entity: str
    """Owner of the project; empty for the default one, which only the account knows."""
    project: str
    name: str
    sweep: str | None
    """Name of the sweep to which runs must belong, which is their group in wandb; None: all."""
    options: Sequence[str]
    """Options of trainings by which runs are compared."""
    planes: FocalPlanes


def dashboard(config: DictConfig, folder: Path) -> None:
    """Write `dashboard.json`, and save workspace and report if asked to."""
    if not isinstance(config.save, bool):
        raise InputError("save must be true or false", got=repr(config.save))
    entity = "" if config.entity is None else str(config.entity)
    if config.save:
        entity = _entity(entity)  # before any work
    sweep = None if config.sweep_name is None else str(config.sweep_name)
    shown = Dashboard(entity, str(config.project), str(config.name), sweep, _options(config), fixed_planes(config))
    try:
        view, page = workspace(shown), report(shown)
    except ValueError as error:  # of wandb-workspaces, on emojis and long titles
        raise InputError(
            "name must be a title that wandb takes", got=f"{shown.name!r} ({first_line(error)})"
        ) from error
    contents = {"workspace": _plain(view._to_model()), "report": _plain(page._to_model())}
    atomic.write_text(folder / SPECIFICATION, json.dumps(contents, indent=1) + "\n")
    if not config.save:
        log.info("specification: %s; save=true saves it in wandb", folder / SPECIFICATION)
        return
    try:
        page.save()  # first: it makes the project if there is none
        view.save()
    except Exception as error:  # the errors of wandb's server have no class in common
        remedy = f"check entity and project; the specification is in {folder / SPECIFICATION}"
        raise InputError("wandb must save the dashboard", got=first_line(error), remedy=remedy) from error
    log.info("workspace: %s", view.url)
    log.info("report: %s", page.url)


def workspace(shown: Dashboard) -> ws.Workspace:
    """Sections of curves and pictures over the trainings, which are grouped by their sweep."""
    by_plane, quantity = plane_names(shown.planes), shown.planes.labels[0].partition(" ")[0]
    sections: dict[str, list[Any]] = {
        "Quality": [_curve(MPSNR_OF_STACK, "MPSNR, dB"), _curve(MSSIM_OF_STACK, "MSSIM")],
        f"By {quantity}": [_bars(shown), _curve(by_plane, f"MPSNR by {quantity}, dB")],
        "By plane": [
            _curve(name, f"{label}: MPSNR, dB") for name, label in zip(by_plane, shown.planes.labels, strict=True)
        ],
        "Losses": [_curve([f"{stage}/{name}" for stage in ("train", "val")], name) for name in (LOSS, *TERMS)],
        "Learning rate and speed": [
            _curve(LEARNING_RATE, "learning rate", log_y=True),
            _curve(PATCHES_PER_SECOND, "patches a second"),
            *(_curve(f"train/{name}", name) for name in COUNTS),
        ],
        "Worst and best patches": [_pictures([PICTURE], "label, prediction, error")],
    }
    closed = "By plane"  # as many panels as planes
    return ws.Workspace(
        entity=shown.entity,
        project=shown.project,
        name=shown.name,
        sections=[ws.Section(name=name, panels=panels, is_open=name != closed) for name, panels in sections.items()],
        settings=ws.WorkspaceSettings(x_axis=STEP, max_runs=100),
        runset_settings=ws.RunsetSettings(
            filters=_filters("train", shown.sweep),
            groupby=[ws.Metric("Group")],
            pinned_columns=[
                f"summary:{MPSNR_OF_STACK}",
                f"summary:{MSSIM_OF_STACK}",
                *(f"config:{_stored(option)}" for option in shown.options),
            ],
        ),
    )


def report(shown: Dashboard) -> wr.Report:
    """A page on a sweep: curves, which options matter, quality by plane, pictures, tables of evaluations."""
    trained = _runs(shown, "train")
    scope = f"the sweep {shown.sweep}" if shown.sweep else f"the project {shown.project}"
    compared = ", ".join(shown.options)
    columns = [wr.ParallelCoordinatesPlotColumn(wr.Config(option)) for option in shown.options]
    target = wr.ParallelCoordinatesPlotColumn(wr.SummaryMetric(MPSNR_OF_STACK), display_name="MPSNR, dB")
    quantity = shown.planes.labels[0].partition(" ")[0]
    blocks: list[Any] = [
        wr.TableOfContents(),
        wr.P(f"Trainings of {scope}: one line per sweep, the mean of its runs with their least and largest value."),
        wr.H1("Validation"),
        _grid(trained, [_curve(MPSNR_OF_STACK, "MPSNR, dB"), _curve(MSSIM_OF_STACK, "MSSIM")]),
        wr.H1("Which options matter"),
        wr.P(f"Runs compared by {compared}. Importance is that of a random forest fitted to the last validation."),
        _grid(
            _runs(shown, "train", is_grouped=False),
            [
                wr.ParameterImportancePlot(with_respect_to=MPSNR_OF_STACK),
                wr.ParallelCoordinatesPlot(columns=[*columns, target], title="options and MPSNR"),
                *(_scatter(option) for option in shown.options),
            ],
        ),
        wr.H1(f"Quality by {quantity}"),
        _grid(trained, [_bars(shown)], per_row=1),
        wr.H1("Worst and best patches"),
        wr.P("Of the last validations, the worst on the left, the best on the right: label, prediction, error."),
        _grid(trained, [_pictures([PICTURE], "worst and best patch")], per_row=1),
        wr.H1("Evaluations"),
        wr.P("Tables and pictures of `lfref eval logger=wandb`: methods against the sources of labels."),
        _grid(
            _runs(shown._replace(sweep=None), "eval", is_grouped=False),  # evaluations belong to no sweep of trainings
            [
                *(wr.WeavePanelSummaryTable(table_name=name) for name in (loggers.SUMMARY, loggers.PLANES)),
                *(_pictures([name], name) for name in (loggers.SCATTER, loggers.QUALITY_BY_PLANE)),
                _pictures([loggers.COMPARISON], loggers.COMPARISON),
            ],
        ),
    ]
    return wr.Report(entity=shown.entity, project=shown.project, title=shown.name, blocks=blocks, width="fluid")


def _options(config: DictConfig) -> list[str]:
    """The options to compare runs by."""
    given = configs.plain(config.options)
    if given is None:
        sweeps = map(OmegaConf.load, sorted(configs.directory("sweeps").glob("*.yaml")))
        return list(dict.fromkeys([*(name for sweep in sweeps for name in sweep.parameters), LEARNING_RATE_OPTION]))
    if not isinstance(given, list) or not given or not all(OPTION.fullmatch(str(option)) for option in given):
        raise InputError("options must be a list of options such as [net.activation]", got=repr(given))
    return [str(option) for option in given]


def _entity(given: str) -> str:
    """The owner of the project, given or the default one of the account; InputError without an account."""
    try:
        account = wandb.Api()
        entity = given or account.default_entity
    except Exception as error:  # those of its server have no class in common
        remedy = "run wandb login, or set WANDB_API_KEY; save=false needs no account"
        raise InputError("save=true needs an account of wandb", got=first_line(error), remedy=remedy) from error
    if not entity:
        raise InputError("the account must have a default entity", got="none", remedy="give entity=TEAM")
    return str(entity)


def _filters(job: str, sweep: str | None) -> list[Any]:
    return [ws.Metric("JobType") == job, *([] if sweep is None else [ws.Metric("Group") == sweep])]


def _runs(shown: Dashboard, job: str, is_grouped: bool = True) -> wr.Runset:
    """Runs of a kind of job. Without an entity, the app takes the project of the report, and asks no server now."""
    groups = ["group"] if is_grouped else []
    return wr.Runset(project=shown.project, name=job, filters=_filters(job, shown.sweep), groupby=groups)


def _curve(names: str | list[str], title: str, **options: Any) -> wr.LinePlot:
    """A plot over the steps. Of a group of runs it shows the mean, and the range as a band."""
    y: list[Any] = [names] if isinstance(names, str) else [*names]
    return wr.LinePlot(
        title=title, x=STEP, y=y, title_x="step", groupby_aggfunc="mean", groupby_rangefunc="minmax", **options
    )


def _bars(shown: Dashboard) -> wr.BarPlot:
    """The last validation, plane by plane."""
    names: list[Any] = list(plane_names(shown.planes))
    return wr.BarPlot(title="MPSNR of each plane, dB", metrics=names, orientation="v", max_bars_to_show=len(names))


def _scatter(option: str) -> wr.ScatterPlot:
    is_rate = option == LEARNING_RATE_OPTION
    return wr.ScatterPlot(
        title=f"MPSNR by {option}", x=wr.Config(option), y=wr.SummaryMetric(MPSNR_OF_STACK), log_x=is_rate
    )


def _pictures(names: list[str], title: str) -> wr.MediaBrowser:
    return wr.MediaBrowser(title=title, media_keys=names, num_columns=2)


def _grid(runs: wr.Runset, panels: list[Any], per_row: int = 2) -> wr.PanelGrid:
    """Panels in rows."""
    width, height = COLUMNS // per_row, 10
    for index, panel in enumerate(panels):
        row, column = divmod(index, per_row)
        panel.layout = wr.Layout(x=column * width, y=row * height, w=width, h=height)
    return wr.PanelGrid(runsets=[runs], panels=panels)


def _stored(option: str) -> str:
    """An option as a column of the table of runs: wandb stores `net.activation` as `net.value.activation`."""
    first, *rest = option.split(".")
    return ".".join([first, "value", *rest])


def _plain(model: Any) -> Any:
    """A part of the specification as the library sends it."""
    return json.loads(model.model_dump_json(by_alias=True, exclude_none=True))


run = command(dashboard)
