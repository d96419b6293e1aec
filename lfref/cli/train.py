"""`lfref train`: fit a network to labels made by an operator."""

import functools
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import wandb
from hydra.core.hydra_config import HydraConfig
from lightning.pytorch import LightningDataModule, Trainer, seed_everything
from lightning.pytorch.plugins.environments import SLURMEnvironment, TorchElasticEnvironment
from omegaconf import DictConfig

from lfref.bench import timing
from lfref.cli import config as configs
from lfref.cli import loggers, resume
from lfref.cli.command import command, log, quiet_libraries
from lfref.cli.main import start
from lfref.cli.run_folder import is_first_process
from lfref.cli.steps import fixed_planes
from lfref.errors import counted
from lfref.io import atomic
from lfref.io import run as runs
from lfref.io.run import Run
from lfref.refocuser.networks import SHIPPED
from lfref.train.callbacks import AtomicCheckpointIO, RankAgreement, TrainingRecord
from lfref.train.modules import MPSNR_OF_STACK, MSSIM_OF_STACK, Fitting, cut_log
from lfref.train.stopping import Stopping, one_line_errors

PARALLEL_LAUNCHERS = (
    "hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher",
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.LocalLauncher",
)
"""Launchers that run several jobs at a time on this machine, all of which see the same GPUs."""
GPU_ACCELERATORS = ("gpu", "cuda", "auto")


def prepare(config: DictConfig, folder: Path) -> bool:
    """Find the checkpoint from which training starts, if any, and cut the log after it.

    Args:
        config: `conf/train.yaml`; its `resume` is set if a job of a sweep continues.
        folder: The run folder.

    Returns:
        False if nothing is left to train.

    Raises:
        InputError: The folder holds another run, or the run to resume was trained on something else.
        CheckpointError: The checkpoint to resume is missing or damaged.
    """
    if config.resume is None and resume.is_sweep_job():
        last = resume.checkpoint_of(folder, list(HydraConfig.get().overrides.task))
        config.resume = None if last is None else str(last)
    # Only the first process checks. If a job of a sweep continues, the others find its checkpoint in the folder.
    if not is_first_process():
        config.resume = config.resume or (str(Run(folder).last) if Run(folder).has_checkpoints else None)
        return True
    if config.resume is None:
        resume.refuse_occupied(folder)
        cut_log(folder / runs.METRICS, 0)
        return True
    plain = configs.plain(config)
    if runs.is_trained(Path(config.resume), plain["trainer"]):
        log.info("%s is trained already; trainer.max_epochs=MORE goes on with it", Run.of(config.resume).folder)
        return False
    resume.prepare(plain, folder)
    return True


def train(config: DictConfig, folder: Path) -> None:
    """Train; checkpoints, logs and pictures go to the run folder.

    Args:
        config: `conf/train.yaml`.
        folder: The run folder.

    Raises:
        LfrefError: Data, configuration or disk do not allow the training.
    """
    quiet_libraries()
    seed_everything(config.seed, workers=True, verbose=False)
    torch.set_float32_matmul_precision(config.matmul_precision)
    data = configs.build(config.data)
    module = build_module(config, data)
    minutes = None if config.checkpoint_minutes is None else configs.number(config, "checkpoint_minutes", 0)
    stopping = Stopping(folder / runs.CHECKPOINTS / "last.ckpt", functools.partial(_give_up, folder), minutes)
    try:
        with one_line_errors(folder):
            trainer = _trainer(config, stopping)
            if trainer.is_global_zero:
                facts = timing.facts(trainer.strategy.root_device)
                atomic.write_text(folder / "machine.json", json.dumps(facts, indent=2) + "\n")
            with stopping.listening(trainer):
                trainer.fit(module, datamodule=data, ckpt_path=config.resume, weights_only=True)
    except SystemExit as stopped:
        if not is_first_process():
            # The first process prints the line. If all agreed to stop, the status is 0: Lightning kills the first
            # process when another one ends with an error.
            raise SystemExit(0 if stopping.agreed else stopped.code) from None
        stopped.add_note(_how_to_go_on(folder))
        raise
    finally:
        # Without this, the jobs of a multirun share one wandb run.
        wandb.finish()
    if trainer.is_global_zero:
        log.info("trained %s; run folder %s", counted(trainer.current_epoch, "epoch"), folder)


def score(config: DictConfig, folder: Path) -> float | None:
    """Best value of what the best checkpoint is chosen by (`val/mpsnr`); None if the run has no checkpoint with one."""
    best = configs.plain(config.callbacks).get("best")
    run = Run(folder)
    return runs.best_value(run.last, best["monitor"]) if best and run.has_checkpoints else None


def _give_up(folder: Path, reason: str) -> None:
    """Print the line of a process that hangs and is ended by force."""
    if is_first_process():
        print(f"lfref train: {reason}; {_how_to_go_on(folder)}", file=sys.stderr)


def _how_to_go_on(folder: Path) -> str:
    """The text that names the last checkpoint, and how to resume, when a signal ends a training."""
    run = Run(folder)
    at = f"the last checkpoint is {run.last}" if run.has_checkpoints else "no epoch was finished"
    if resume.is_sweep_job():
        return f"{at}; to continue the sweep, repeat its command with output={HydraConfig.get().sweep.dir}"
    return f"{at}; " + (
        f"go on by lfref train resume={folder}" if run.has_checkpoints else "the same command starts anew"
    )


def build_module(config: DictConfig, data: LightningDataModule) -> Fitting:
    """The module that trains the configured network, with the weights that it starts from."""
    options: dict[str, Any] = {}
    if "planes" in config.task:
        options = {"planes": fixed_planes(config), "is_linear": getattr(data, "is_linear", True)}
    module: Fitting = configs.build(config.task, **options)
    if config.start is not None:
        path = Path(config.start)
        start = SHIPPED.get(config.start) or (Run.of(path).best if path.is_dir() else path)
        module.start_from(start)
        log.info("training starts from the weights of %s", config.start)
    if config.channels_last:
        module.net.to(memory_format=torch.channels_last)
    if config.compile:
        module.net.compile()  # in place, so that checkpoints keep the names of the weights
    return module


def _trainer(config: DictConfig, stopping: Stopping) -> Trainer:
    named = configs.build(config.callbacks)
    if config.start is not None:
        named.pop("initialization", None)  # the weights are there already
    chosen = [callback for callback in named.values() if callback is not None]
    record = TrainingRecord(Path(config.folder) / runs.TRAINING)
    callbacks = [RankAgreement(configs.fingerprint(config)), *chosen, record, stopping]
    logger = loggers.started(config, "train", compared_by=(MPSNR_OF_STACK, MSSIM_OF_STACK))
    devices = _devices(configs.plain(config.trainer))
    plugins: list[Any] = [AtomicCheckpointIO()]
    if SLURMEnvironment.detect() and not TorchElasticEnvironment.detect():
        # Lightning would answer a signal by a checkpoint of its own, which `resume=auto` does not know.
        plugins.append(SLURMEnvironment(auto_requeue=False))
    return configs.build(config.trainer, callbacks=callbacks, logger=logger, plugins=plugins, devices=devices)


def _devices(trainer: Mapping[str, Any]) -> Any:
    """The devices of the trainer; if a launcher runs jobs side by side here, those of this job."""
    if not resume.is_sweep_job():
        return trainer.get("devices", "auto")
    hydra = HydraConfig.get()
    is_given = "trainer.devices" in map(resume.key_of, hydra.overrides.task)
    is_parallel = hydra.launcher._target_ in PARALLEL_LAUNCHERS
    return devices_of_job(trainer, hydra.job.num) if is_parallel and not is_given else trainer.get("devices", "auto")


def devices_of_job(trainer: Mapping[str, Any], number: int) -> Any:
    """Devices of a job that runs beside other jobs on this machine: if it takes one GPU, they take the GPUs in turn.

    Args:
        trainer: The configured trainer.
        number: Number of the job in its sweep, from 0.
    """
    devices = trainer.get("devices", "auto")
    takes_one_gpu = devices == 1 and trainer.get("accelerator", "auto") in GPU_ACCELERATORS
    n_gpus = torch.cuda.device_count() if takes_one_gpu else 0
    return [number % n_gpus] if n_gpus else devices


run = command(train, prepare, score)

if __name__ == "__main__":  # further processes of a distributed training
    start("train", sys.argv[1:])
