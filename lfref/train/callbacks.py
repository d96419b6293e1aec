"""What happens around the training steps: a living start for the head, pictures, and ranks that agree."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Callback, Trainer
from torch import Tensor

from lfref.data.patches import Batch
from lfref.errors import InputError
from lfref.io import images
from lfref.train.guard import finite_patches


class HeadInitialization(Callback):
    """Lets the network start itself on the first batch, for RefNet so that no output channel is born dead."""

    def __init__(self) -> None:
        self._is_due = False

    def on_train_start(self, trainer: Trainer, module: Any) -> None:
        """A run that was resumed keeps its head."""
        self._is_due = trainer.global_step == 0

    def on_train_batch_start(self, trainer: Trainer, module: Any, batch: Batch, batch_index: int) -> None:
        """Act once, on the first batch that is finite in every process."""
        if not (self._is_due and trainer.strategy.reduce_boolean_decision(_is_finite(batch))):
            return
        self._is_due = False
        # Every process adds what it saw, so that all take the same start, that of the whole batch.
        total = functools.partial(trainer.strategy.reduce, reduce_op="sum")
        module.net.prime(batch["views"], batch["slopes"], batch["labels"], total)


class StackPictures(Callback):
    """Shows label and prediction of the first held-out patch at a few planes after each validation.

    Args:
        folder: Where the PNG files go; loggers that take images get them too.
        slopes: Planes to show, in pixels per view step; the nearest there are.
    """

    def __init__(self, folder: str, slopes: Sequence[float] = (-7.0, 0.0, 0.5)) -> None:
        self.folder = Path(folder)
        self.slopes = tuple(slopes)

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        module: Any,
        outputs: Any,
        batch: Batch,
        batch_index: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Make the picture from the first batch."""
        if batch_index > 0 or trainer.sanity_checking or not trainer.is_global_zero:
            return
        planes = [nearest(module.planes.values, slope) for slope in self.slopes]
        picture = side_by_side(batch["labels"][0, planes], outputs[0, planes])
        images.write_image(self.folder / f"epoch_{trainer.current_epoch:04d}.png", picture.permute(1, 2, 0).numpy())
        for logger in trainer.loggers:
            log_picture(logger, picture, trainer.global_step)


class RankAgreement(Callback):
    """Refuses to train when the processes of a distributed run were configured differently.

    A sweeper under `ddp` starts each rank with its own draw of hyper-parameters, which would train nonsense.

    Args:
        fingerprint: Hash of this process's configuration.
    """

    def __init__(self, fingerprint: str) -> None:
        self.fingerprint = fingerprint

    def setup(self, trainer: Trainer, pl_module: Any, stage: str) -> None:
        """Compare with rank 0; every rank hears of a difference, so that none waits for one that has left."""
        differs = torch.tensor(float(trainer.strategy.broadcast(self.fingerprint) != self.fingerprint))
        if trainer.strategy.reduce(differs.to(trainer.strategy.root_device), reduce_op="sum") > 0:
            raise InputError(
                "all processes of a distributed run must have the same configuration",
                got="different ones",
                remedy="start one run at a time instead of a sweep that draws for every process",
            )


def _is_finite(batch: Batch) -> bool:
    return all(bool(each.all()) for each in finite_patches(batch).values())


def nearest(slopes: Sequence[float], slope: float) -> int:
    """Index of the plane whose slope is nearest."""
    return min(range(len(slopes)), key=lambda i: abs(slopes[i] - slope))


def side_by_side(labels: Tensor, stack: Tensor) -> Tensor:
    """Labels above predictions, planes from left to right.

    Args:
        labels: [K, C, H, W] in [0, 1].
        stack: [K, C, H, W].

    Returns:
        Picture in [0, 1], float32, CPU, [C, 2 H, K W].
    """
    rows = [torch.cat(list(images.detach().float().cpu()), dim=-1) for images in (labels, stack)]
    return torch.cat(rows, dim=-2).nan_to_num().clamp(0, 1)


def log_picture(logger: Any, picture: Tensor, step: int) -> None:
    """Hand a picture [C, H, W] to a logger that takes pictures (wandb, tensorboard); others are left alone."""
    if hasattr(logger, "log_image"):
        logger.log_image("val/stack", [picture], step=step)
    elif hasattr(logger.experiment, "add_image"):
        logger.experiment.add_image("val/stack", picture, step)
