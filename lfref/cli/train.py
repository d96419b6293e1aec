"""`lfref train`: fit a network to labels made by an operator."""

import sys
from pathlib import Path

import torch
import wandb
from lightning.pytorch import LightningDataModule, Trainer, seed_everything
from omegaconf import DictConfig

from lfref.bench import timing
from lfref.cli import config as configs
from lfref.cli import loggers
from lfref.cli.command import command, is_first_process, is_sweep_job, log, quiet_libraries
from lfref.cli.main import start
from lfref.cli.steps import fixed_planes
from lfref.errors import counted
from lfref.io.run import CHECKPOINTS, METRICS, TRAINING, Run
from lfref.nets import checkpoint as checkpoints
from lfref.refocuser.networks import SHIPPED
from lfref.train.callbacks import AtomicCheckpointIO, RankAgreement, StopOnSigterm, TrainingRecord
from lfref.train.modules import Refocusing


def train(config: DictConfig, folder: Path) -> float | None:
    """Train into the run folder; returns the best value of what the best checkpoint is chosen by (`val/mpsnr`)."""
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
        timing.write_facts(folder, trainer.strategy.root_device)
    try:
        trainer.fit(module, datamodule=data, ckpt_path=checkpoint, weights_only=True)
    except SystemExit:
        log.info("stopped; go on by lfref train resume=%s", folder)
        raise
    finally:
        # Without this, the jobs of a multirun share one wandb run.
        wandb.finish()
    if trainer.is_global_zero:
        epochs = counted(trainer.current_epoch, "epoch")
        log.info("trained %s into %s; refocus by it: lfref refocus LIGHT_FIELD run=%s", epochs, folder, folder)
    return own.training["best_value"]


def _checkpoint(config: DictConfig, own: Run) -> Path | None:
    """The checkpoint from which training goes on; None: it begins."""
    if config.resume is not None:
        run = Run.of(config.resume)
        return run.chosen or (run.last if run.has_checkpoints else None)
    # Lightning starts further processes without the mode of a sweep, whose jobs go on by themselves.
    goes_on = not is_first_process() and own.has_checkpoints and not config.overwrite
    return own.last if goes_on else None


def build_module(config: DictConfig, data: LightningDataModule) -> Refocusing:
    """The module that trains the configured network, with the weights that it starts from."""
    net, loss, optimizer, scheduler, metrics = (
        configs.build(config.get(name)) for name in ("net", "loss", "optimizer", "scheduler", "metrics")
    )
    planes, is_linear = fixed_planes(config), getattr(data, "is_linear", True)
    module = Refocusing(net, loss, planes, optimizer, scheduler, config.end_rate, is_linear, metrics)
    if config.init_from is not None:
        path = Path(config.init_from)
        weights = SHIPPED.get(config.init_from) or (Run.of(path).best if path.is_dir() else path)
        checkpoints.start(module.net, weights)
        log.info("training starts from the weights of %s", config.init_from)
    if config.channels_last:
        module.net.to(memory_format=torch.channels_last)
    if config.compile:
        module.net.compile()  # in place, so that checkpoints keep the names of the weights
    return module


def _trainer(config: DictConfig) -> Trainer:
    named = configs.build(config.callbacks)
    if config.init_from is not None:
        named.pop("initialization", None)  # the weights are there already
    chosen = [callback for callback in named.values() if callback is not None]
    folder = Path(config.folder)
    stopping = StopOnSigterm(folder / CHECKPOINTS / "last.ckpt")
    callbacks = [RankAgreement(configs.fingerprint(config)), *chosen, TrainingRecord(folder / TRAINING), stopping]
    logger = loggers.started(config, "train")
    return configs.build(config.trainer, callbacks=callbacks, logger=logger, plugins=[AtomicCheckpointIO()])


run = command(train)

if __name__ == "__main__":  # further processes of a distributed training
    start("train", sys.argv[1:])
