"""`lfref train`: fit a network to labels made by an operator."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import wandb
from hydra.core.hydra_config import HydraConfig
from lightning.pytorch import LightningDataModule, Trainer, seed_everything
from omegaconf import DictConfig

from lfref.bench import timing
from lfref.cli import config as configs
from lfref.cli import loggers
from lfref.cli.command import command, is_first_process, is_sweep_job, log, quiet_libraries
from lfref.cli.main import start
from lfref.cli.steps import fixed_planes
from lfref.errors import counted
from lfref.io import atomic
from lfref.io.run import CHECKPOINTS, METRICS, TRAINING, Run
from lfref.nets.refiner import Refiner
from lfref.refocuser.networks import SHIPPED
from lfref.train.callbacks import AtomicCheckpointIO, RankAgreement, TrainingRecord
from lfref.train.modules import Fitting, Refining, Refocusing
from lfref.train.signals import StopOnSigterm

PARALLEL_LAUNCHERS = (
    "hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher",
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.LocalLauncher",
)
"""Launchers that run several jobs at a time on this machine, all of which see the same GPUs."""
GPU_ACCELERATORS = ("gpu", "cuda", "auto")


def train(config: DictConfig, folder: Path) -> float | None:
    """Train; checkpoints, logs and pictures go to the run folder.

    Args:
        config: `conf/train.yaml`.
        folder: The run folder.

    Returns:
        The best value of what the best checkpoint is chosen by (`val/mpsnr`); None if there is none.

    Raises:
        LfrefError: Data, configuration or disk do not allow the training.
    """
    own = Run(folder)
    if is_sweep_job() and own.is_finished:
        return own.training["best_value"]
    quiet_libraries()
    seed_everything(config.seed, workers=True, verbose=False)
    torch.set_float32_matmul_precision(config.matmul_precision)
    checkpoint = _checkpoint(config, own)
    if checkpoint is None and is_first_process():
        (folder / METRICS).unlink(missing_ok=True)
    data = configs.build(config.data)
    module = build_module(config, data)
    trainer = _trainer(config)
    if trainer.is_global_zero:
        facts = timing.facts(trainer.strategy.root_device)
        atomic.write_text(folder / "machine.json", json.dumps(facts, indent=2) + "\n")
    try:
        trainer.fit(module, datamodule=data, ckpt_path=checkpoint, weights_only=True)
    except SystemExit:
        log.info("stopped; go on by lfref train resume=%s", folder)
        raise
    finally:
        # Without this, the jobs of a multirun share one wandb run.
        wandb.finish()
    if trainer.is_global_zero:
        log.info("trained %s; run folder %s", counted(trainer.current_epoch, "epoch"), folder)
    return own.training["best_value"]


def _checkpoint(config: DictConfig, own: Run) -> Path | None:
    """The checkpoint from which training goes on; None: it begins."""
    if config.resume is not None:
        run = Run.of(config.resume)
        return run.chosen or (run.last if run.has_checkpoints else None)
    # Lightning starts further processes without the mode of a sweep, whose jobs go on by themselves.
    goes_on = not is_first_process() and own.has_checkpoints and not config.overwrite
    return own.last if goes_on else None


def build_module(config: DictConfig, data: LightningDataModule) -> Fitting:
    """The module that trains the configured network, with the weights that it starts from."""
    net, loss, optimizer, scheduler, metrics = (
        configs.build(config[name]) for name in ("net", "loss", "optimizer", "scheduler", "metrics")
    )
    module: Fitting
    if isinstance(net, Refiner):
        module = Refining(net, loss, configs.build(config.data.recipe), optimizer, scheduler, metrics)
    else:
        planes, is_linear = fixed_planes(config), getattr(data, "is_linear", True)
        module = Refocusing(net, loss, planes, optimizer, scheduler, config.end_rate, is_linear, metrics)
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


def _trainer(config: DictConfig) -> Trainer:
    named = configs.build(config.callbacks)
    if config.start is not None:
        named.pop("initialization", None)  # the weights are there already
    chosen = [callback for callback in named.values() if callback is not None]
    folder = Path(config.folder)
    stopping = StopOnSigterm(folder / CHECKPOINTS / "last.ckpt")
    callbacks = [RankAgreement(configs.fingerprint(config)), *chosen, TrainingRecord(folder / TRAINING), stopping]
    logger = loggers.started(config, "train")
    devices = _devices(configs.plain(config.trainer))
    plugins = [AtomicCheckpointIO()]
    return configs.build(config.trainer, callbacks=callbacks, logger=logger, plugins=plugins, devices=devices)


def _devices(trainer: Mapping[str, Any]) -> Any:
    """The devices of the trainer; jobs of a sweep that take one GPU each and run side by side take them in turn."""
    devices, n_gpus = trainer.get("devices", "auto"), torch.cuda.device_count()
    takes_one_gpu = devices == 1 and trainer.get("accelerator", "auto") in GPU_ACCELERATORS and n_gpus > 0
    if not (takes_one_gpu and is_sweep_job() and HydraConfig.get().launcher._target_ in PARALLEL_LAUNCHERS):
        return devices
    return [HydraConfig.get().job.num % n_gpus]


run = command(train)

if __name__ == "__main__":  # further processes of a distributed training
    start("train", sys.argv[1:])
