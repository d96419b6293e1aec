"""Loggers of `lfref train` and `lfref eval`: which run of Weights & Biases they write to, tables and pictures."""

import contextlib
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lfref import __version__
from lfref.cli import config as configs
from lfref.cli.command import is_first_process, is_sweep_job
from lfref.io import atomic, images
from lfref.io import run as runs
from lfref.io.run import Run, key_of
from lfref.train.callbacks import log_picture

if TYPE_CHECKING:
    import pandas as pd

SUMMARY, PLANES = "eval/summary", "eval/planes"
SCATTER, QUALITY_BY_PLANE, COMPARISON = "eval/scatter", "eval/quality_by_plane", "eval/comparison"
ID = "wandb_id.txt"
"""File in the run folder with the id of its run in wandb, in which a resumed training goes on."""


def started(config: DictConfig, job_type: str) -> list[Any]:
    """The configured loggers, each of which has logged the whole configuration; `job_type` is the command."""
    loggers = []
    for name, settings in (config.get("logger") or {}).items():
        if name == "csv" and job_type == "eval":  # whose tables are CSV files anyway
            continue
        is_wandb = str(settings._target_).endswith("WandbLogger")
        logger = configs.build(settings, **(_wandb_run(settings, config) | {"job_type": job_type} if is_wandb else {}))
        logger.log_hyperparams(configs.plain(config) | {"code": code()})
        if is_wandb and is_first_process():
            atomic.write_text(Path(config.folder) / ID, f"{logger.version}\n")
        loggers.append(logger)
    return loggers


def _wandb_run(settings: Mapping[str, Any], config: DictConfig) -> dict[str, str]:
    """Id of the run that goes on in this folder; group of a sweep; name: what a job varies, or all overrides."""
    folder, known = Path(config.folder), {}
    if config.get("resume") and Run.of(config.resume).folder == folder and (folder / ID).is_file():
        known["id"] = (folder / ID).read_text("utf-8").strip()
    if is_sweep_job():
        known["group"] = Path(HydraConfig.get().sweep.dir).absolute().name
    if HydraConfig.initialized():
        words = [word for word in HydraConfig.get().overrides.task if not (is_sweep_job() and word in sys.argv)]
        known["name"] = " ".join(word for word in words if key_of(word) not in runs.FOLDERS)[:128]
    return {key: value for key, value in known.items() if value and settings.get(key) is None}


def log_evaluation(loggers: Iterable[Any], summary: "pd.DataFrame", planes: "pd.DataFrame", folder: Path) -> None:
    """Give loggers the tables of an evaluation, its means over light fields, and the pictures in its folder."""
    means = summary.groupby(["method", "reference"], sort=False)[["mpsnr_db", "mssim"]].mean()
    values = {
        f"eval/{method}/{reference}/{quality}": float(value)
        for (method, reference), row in means.iterrows()
        for quality, value in row.items()
    }
    figures = [(name, folder / f"{name.partition('/')[2]}.png", 0) for name in (SCATTER, QUALITY_BY_PLANE)]
    comparisons = [folder / "comparison" / f"{name}.png" for name in summary["light_field"].unique()]
    figures += [(COMPARISON, path, step) for step, path in enumerate(comparisons)]
    for logger in loggers:
        logger.log_metrics(values, step=0)
        if hasattr(logger, "log_table"):
            for name, table in ((SUMMARY, summary), (PLANES, planes)):
                # Tables of wandb take no numbers of NumPy, and None for a missing one.
                cells = table.astype(object).where(table.notna(), None)
                logger.log_table(name, columns=[*table.columns], data=cells.to_numpy().tolist())
        for name, path, step in figures:
            if path.is_file():  # one light field has no scatter
                picture = torch.from_numpy(images.to_float(images.read_image(path))).permute(2, 0, 1)
                log_picture(logger, picture, step, path.stem, name)
        logger.finalize("success")


def code() -> str:
    """The commit of the working directory, or the version of lfref where there is none."""
    command = ["git", "rev-parse", "HEAD"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    return f"lfref {__version__}"
