"""`lfref train`: fit a network to labels made by an operator."""

from pathlib import Path
from typing import Any

import torch
import wandb
from lightning.pytorch import Trainer, seed_everything
from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli.command import command, log, quiet_libraries
from lfref.errors import CheckpointError, InputError
from lfref.nets import checkpoint as checkpoints
from lfref.train.callbacks import RankAgreement
from lfref.train.module import Refocusing
from lfref.train.storage import AtomicCheckpointIO


def train(config: DictConfig, folder: Path) -> None:
    """Train; checkpoints, logs and pictures go to the run folder.

    Args:
        config: `conf/train.yaml`.
        folder: The run folder.
    """
    quiet_libraries()
    seed_everything(config.seed, workers=True, verbose=False)
    torch.set_float32_matmul_precision(config.matmul_precision)
    resume = _resumed(config.resume)
    data, module = configs.build(config.data), _module(config)
    try:
        trainer = _trainer(config)
        trainer.fit(module, datamodule=data, ckpt_path=resume, weights_only=True)
    finally:
        # Without this, the jobs of a multirun share one wandb run.
        wandb.finish()
    if trainer.is_global_zero:
        log.info("trained %d epochs; run folder %s", trainer.current_epoch, folder)


def _module(config: DictConfig) -> Refocusing:
    return Refocusing(
        net=configs.build(config.net),
        loss=configs.build(config.loss),
        planes=configs.build(config.planes),
        optimizer=configs.build(config.optimizer),
        scheduler=configs.build(config.scheduler),
    )


def _trainer(config: DictConfig) -> Trainer:
    chosen = [callback for callback in configs.build(config.callbacks).values() if callback is not None]
    callbacks = [RankAgreement(configs.fingerprint(config)), *chosen]
    loggers = _loggers(config)
    return configs.build(config.trainer, callbacks=callbacks, logger=loggers, plugins=[AtomicCheckpointIO()])


def _loggers(config: DictConfig) -> list[Any]:
    """The loggers, each told the whole configuration."""
    loggers = [configs.build(logger) for logger in config.logger.values()]
    try:
        for logger in loggers:
            logger.log_hyperparams(configs.plain(config))
    except wandb.errors.Error as error:
        remedy = "run wandb login, or set logger.wandb.offline=true"
        raise InputError("wandb must be able to start a run", got=error, remedy=remedy) from error
    return loggers


def _resumed(path: str | None) -> str | None:
    """The checkpoint to go on from, known to be one of a training run."""
    if path is not None and "optimizer_states" not in checkpoints.read(path):
        raise CheckpointError(
            f"{path} holds a network but no training to resume", remedy="give RUN/checkpoints/last.ckpt"
        )
    return path


main = command(train)

if __name__ == "__main__":
    main()
