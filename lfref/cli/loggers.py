"""Loggers of a run, for every command that has some: they get its configuration, and tables and pictures in one way.

A logger takes what it can: wandb all, TensorBoard tables as text, the others numbers.
"""

import contextlib
import math
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import wandb
from lightning.pytorch.loggers import TensorBoardLogger
from omegaconf import DictConfig
from torch import Tensor

from lfref import __version__, extras
from lfref.cli import config as configs
from lfref.cli import wandb_runs
from lfref.cli.run_folder import is_first_process
from lfref.io import images
from lfref.train.callbacks import log_picture

if TYPE_CHECKING:
    import pandas as pd

SUMMARY, PLANES = "eval/summary", "eval/planes"
"""Names of the tables of an evaluation."""
SCATTER, QUALITY_BY_PLANE, COMPARISON = "eval/scatter", "eval/quality_by_plane", "eval/comparison"
"""Names of its pictures."""


def started(
    config: DictConfig, job_type: str, without: Sequence[str] = (), compared_by: Sequence[str] = ()
) -> list[Any]:
    """The configured loggers, each of which has logged the whole configuration.

    Args:
        config: The configuration of the command.
        job_type: Kind of the run, for wandb: the command.
        without: Names of loggers that are left out.
        compared_by: Metrics beside which TensorBoard shows the options of runs.

    Raises:
        InputError: A package is missing, or wandb cannot start a run.
    """
    chosen = {name: settings for name, settings in (config.get("logger") or {}).items() if name not in without}
    if "tensorboard" in chosen:  # Lightning would fail later, and say less
        extras.check("tensorboard", "logger=tensorboard")
    built = [(settings, _build(settings, config, job_type)) for settings in chosen.values()]
    with wandb_runs.one_line_errors():
        for settings, logger in built:
            logger.log_hyperparams(configs.plain(config) | {"code": code()})
            if not is_first_process():
                continue
            if wandb_runs.is_wandb(settings):
                wandb_runs.keep_id(logger, Path(config.folder))
            if compared_by and isinstance(logger, TensorBoardLogger):
                _log_options(logger, configs.plain(config), compared_by)
    return [logger for _, logger in built]


@contextlib.contextmanager
def running(config: DictConfig, job_type: str, without: Sequence[str] = ()) -> Iterator[list[Any]]:
    """Loggers as of `started`, for a command without a trainer, which would end them."""
    loggers: list[Any] = []
    try:
        loggers = started(config, job_type, without)
        yield loggers
        for logger in loggers:
            logger.finalize("success")
    finally:
        if loggers:
            wandb.finish()  # else the jobs of a multirun share one run


def log_evaluation(loggers: Iterable[Any], summary: "pd.DataFrame", planes: "pd.DataFrame", folder: Path) -> None:
    """Give loggers the tables of an evaluation, its means over light fields, and the pictures in its folder."""
    means = summary.groupby(["method", "reference"], sort=False)[["mpsnr_db", "mssim"]].mean()
    values = {
        f"eval/{method}/{reference}/{quality}": float(value)
        for (method, reference), row in means.iterrows()
        for quality, value in row.items()
    }
    figures = {name: folder / f"{name.partition('/')[2]}.png" for name in (SCATTER, QUALITY_BY_PLANE)}
    figures = {name: path for name, path in figures.items() if path.is_file()}  # one light field has no scatter
    comparisons = [folder / "comparison" / f"{name}.png" for name in summary["light_field"].unique()]
    for logger in loggers:
        logger.log_metrics(values, step=0)
        log_table(logger, SUMMARY, summary)
        log_table(logger, PLANES, planes)
        for name, path in figures.items():
            log_picture(logger, _picture(path), 0, path.stem, name)
        for step, path in enumerate(comparisons):
            log_picture(logger, _picture(path), step, path.stem, COMPARISON)


def log_table(logger: Any, name: str, table: "pd.DataFrame") -> None:
    """Give a table to a logger of wandb, or as text to one of TensorBoard."""
    rows = [[_cell(value) for value in row] for row in table.itertuples(index=False)]
    if hasattr(logger, "log_table"):
        logger.log_table(name, columns=[*table.columns], data=rows)
    elif hasattr(logger.experiment, "add_text"):
        lines = [[*table.columns], ["---"] * len(table.columns), *rows]
        logger.experiment.add_text(name, "\n".join(f"| {' | '.join(map(_text, line))} |" for line in lines))


def _log_options(logger: Any, config: Mapping[str, Any], metrics: Sequence[str]) -> None:
    """Enter options and metrics into TensorBoard's table of runs; Lightning would log a first value of each metric."""
    from torch.utils.tensorboard.summary import hparams  # needs tensorboard, an extra

    options = {key: value if isinstance(value, bool | int | float) else str(value) for key, value in _leaves(config)}
    for summary in hparams(options, dict.fromkeys(metrics, 0.0)):
        logger.experiment._get_file_writer().add_summary(summary)


def _leaves(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Keys such as `net.activation` with their values."""
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def code() -> str:
    """The commit of the working directory, or the version of lfref where there is none."""
    command = ["git", "rev-parse", "HEAD"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    return f"lfref {__version__}"


def _build(settings: DictConfig, config: DictConfig, job_type: str) -> Any:
    is_wandb = wandb_runs.is_wandb(settings)
    return configs.build(settings, **wandb_runs.options(settings, config, job_type) if is_wandb else {})


def _picture(path: Path) -> Tensor:
    """A picture file in [0, 1], [C, H, W]."""
    return torch.from_numpy(images.to_float(images.read_image(path))).permute(2, 0, 1)


def _text(cell: Any) -> str:
    return "" if cell is None else f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _cell(value: Any) -> Any:
    """A cell that a table of wandb takes: no number of NumPy, and None for a missing one."""
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and math.isnan(plain) else plain
