"""Callbacks, logger and checkpoint files of a training.

`StepGuard` keeps numbers that are not finite out of weights and checkpoints; `Initialization` starts the weights;
`StackPictures` shows progress; `RankAgreement` compares the processes of a distributed run; `TrainingRecord` notes time
and size; `StopOnSigterm` ends a training.
"""

import csv
import functools
import json
import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from lightning.fabric.loggers.csv_logs import _ExperimentWriter
from lightning.pytorch import Callback, Trainer, loggers
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers.csv_logs import ExperimentWriter
from lightning.pytorch.loggers.logger import rank_zero_experiment
from lightning.pytorch.plugins import TorchCheckpointIO
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.data.crops import Batch
from lfref.errors import InputError, LfrefError, counted
from lfref.functional.psnr import psnr
from lfref.io import atomic, images, tensor_files

log = logging.getLogger(__name__)

SKIPPED = "train/skipped"
PICTURE = "val/stack"
STATUS = 143
"""Exit status of a process that SIGTERM ends, as shells count it."""


class StepGuard(Callback):
    """Skips steps whose loss or gradient is not finite, and stops after `patience` of them in a row.

    A skipped step leaves weights, moments of the optimiser and running statistics unchanged. It is counted, and logged
    with its patches. All processes of a distributed run decide alike without asking each other: a loss that is not
    finite makes its gradients NaN, and DDP's mean of gradients carries these to all processes. A gradient counts as
    finite if float32 holds its norm, since Adam squares its entries. Under float16, an overflow is left to the scaler
    of the loss, which skips the step and tries a smaller scale.
    """

    def __init__(self, patience: int = 10) -> None:
        self.patience = patience
        self.skipped = 0
        """Number of skipped steps."""
        self.in_a_row = 0
        """Number of steps skipped since the last complete step."""
        self._places: list[str] = []
        self._losses: list[Tensor] = []
        self._statistics: list[Tensor] = []

    def on_train_batch_start(self, trainer: Trainer, module: Any, batch: Mapping[str, Any], batch_index: int) -> None:
        """Record the batch, and at the first batch of a step the running statistics."""
        if not self._places:
            self._statistics = [buffer.clone() for buffer in module.buffers()]
        self._places += batch["where"]

    def on_before_backward(self, trainer: Trainer, module: Any, loss: Tensor) -> None:
        """Record the loss; one that is not finite makes all gradients NaN."""
        self._losses.append(loss.detach())
        factor = torch.where(loss.detach().isfinite(), 1.0, torch.nan)
        loss.register_hook(lambda gradient: gradient * factor)

    def on_before_optimizer_step(self, trainer: Trainer, module: Any, optimizer: torch.optim.Optimizer) -> None:
        """Remove the gradients if one of them or the loss is not finite: optimisers skip weights without a gradient."""
        is_loss_finite = torch.stack(self._losses).isfinite().all()
        norm = nn.utils.get_total_norm([each.grad for each in module.parameters() if each.grad is not None])
        places, self._places, self._losses = self._places, [], []
        if norm.isfinite():
            self.in_a_row = 0
            return
        optimizer.zero_grad(set_to_none=True)
        for buffer, value in zip(module.buffers(), self._statistics, strict=True):
            buffer.copy_(value)
        refuse_corrupted(module.state_dict(), "train from the last checkpoint with a lower learning rate")
        if is_loss_finite and getattr(trainer.precision_plugin, "scaler", None) is not None:
            return
        self.skipped += 1
        self.in_a_row += 1
        cause = f"{'gradient' if is_loss_finite else 'loss'} of {', '.join(places)}"
        place = trainer.current_epoch, trainer.global_step
        log.warning("epoch %d, step %d skipped (%d so far), not finite: %s", *place, self.skipped, cause)
        if self.in_a_row >= self.patience:
            got = f"none in {counted(self.in_a_row, 'step')}, the last cause being {cause}"
            remedy = "lower optimizer.lr or set trainer.gradient_clip_val=1"
            raise LfrefError("training needs steps with a finite loss and gradient", got=got, remedy=remedy)

    def on_train_epoch_end(self, trainer: Trainer, module: Any) -> None:
        """Log the number of skipped steps."""
        module.log(SKIPPED, float(self.skipped), sync_dist=True, reduce_fx="max")

    def on_save_checkpoint(self, trainer: Trainer, module: Any, checkpoint: dict[str, Any]) -> None:
        """Refuse to write weights that are not finite."""
        refuse_corrupted(checkpoint["state_dict"], "no checkpoint was written; go on from the last one")

    def state_dict(self) -> dict[str, int]:
        """The counts, as a checkpoint keeps them."""
        return {"skipped": self.skipped, "in_a_row": self.in_a_row}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Restore the counts."""
        self.skipped, self.in_a_row = state["skipped"], state["in_a_row"]


class BestCheckpoint(ModelCheckpoint):
    """Lightning's own, which here remembers the best value also if the run folder has moved."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the best value."""
        own = {name: self._here(state_dict[name]) for name in ("best_model_path", "kth_best_model_path")}
        best = {self._here(path): score for path, score in state_dict["best_k_models"].items()}
        super().load_state_dict(state_dict | own | {"best_k_models": best, "dirpath": self.dirpath})

    def _here(self, path: str) -> str:
        return str(Path(self.dirpath or "") / Path(path).name) if path else ""


def refuse_corrupted(state: Mapping[str, Any], remedy: str) -> None:
    """Raise an LfrefError that names the first tensor that is not finite."""
    for name, value in state.items():
        if isinstance(value, Tensor) and not bool(value.isfinite().all()):
            raise LfrefError(f"weights must be finite; {name} is not", remedy=remedy)


class Initialization(Callback):
    """Starts a new network's weights on its first crops, of all processes together (see `Network.initialize`)."""

    def __init__(self, n_crops: int = 24) -> None:
        self.n_crops = n_crops

    def on_train_start(self, trainer: Trainer, module: Any) -> None:
        """Start the weights of a new run; a resumed run keeps its own. Training sees the same batches again."""
        if trainer.global_step > 0:
            return
        log.info("computing the first weights from %d crops", self.n_crops)
        views, labels = [], []
        for batch in map(trainer.strategy.batch_to_device, trainer.train_dataloader):  # type: ignore[arg-type]
            is_finite = batch["views"].isfinite().flatten(1).all(1) & batch["labels"].isfinite().flatten(1).all(1)
            views.append(batch["views"][is_finite])
            labels.append(batch["labels"][is_finite])
            if trainer.world_size * sum(map(len, views)) >= self.n_crops:
                break
        # Sums over the processes give all of them the start that all crops together would give.
        total = functools.partial(trainer.strategy.reduce, reduce_op="sum")
        module.net.initialize(torch.cat(views), batch["slopes"], torch.cat(labels), total)


class StackPictures(Callback):
    """Writes a picture of the worst and the best held-out patch after each validation, also for loggers.

    The planes nearest to these slopes are shown; in a distributed run, patches of the first process.
    """

    def __init__(self, folder: str, slopes: Sequence[float] = (-7.0, 0.0, 0.5)) -> None:
        self.folder = Path(folder)
        self.slopes = tuple(slopes)
        self._patches: list[tuple[float, Tensor]] = []
        """MPSNR in dB, minus infinity if a prediction is not finite, and picture of the worst and the best patch."""

    def on_validation_epoch_start(self, trainer: Trainer, module: Any) -> None:
        """Forget the patches of the last validation."""
        self._patches = []

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        module: Any,
        outputs: Any,
        batch: Batch,
        batch_index: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Keep the worst and the best patch so far."""
        if trainer.sanity_checking or not trainer.is_global_zero:
            return
        planes = [int((module.planes.slopes - slope).abs().argmin()) for slope in self.slopes]
        values = psnr(outputs.float(), batch["labels"].float()).mean(-1).nan_to_num(nan=-torch.inf)
        for value, labels, stack in zip(values.tolist(), batch["labels"], outputs, strict=True):
            patches = [*self._patches, (value, side_by_side(labels[planes], stack[planes]))]
            self._patches = sorted(patches, key=lambda patch: patch[0])[:: max(1, len(patches) - 1)]

    def on_validation_epoch_end(self, trainer: Trainer, module: Any) -> None:
        """Write the picture: the worst patch on the left, the best on the right."""
        if not self._patches:
            return
        values, pictures = zip(*self._patches, strict=True)
        picture = torch.cat([F.pad(each, (0, GAP), value=1.0) for each in pictures], -1)[..., :-GAP]
        images.write_image(self.folder / f"patches_{trainer.current_epoch:04d}.png", picture.permute(1, 2, 0).numpy())
        caption = f"worst patch, {values[0]:.2f} dB, and best, {values[-1]:.2f} dB: labels, predictions, errors x 4"
        for logger in trainer.loggers:
            log_picture(logger, picture, trainer.global_step, caption)


class RankAgreement(Callback):
    """Refuses to train when `fingerprint`, a hash of the configuration, differs between processes of a distributed run.

    A sweeper under `ddp` starts each rank with its own draw of hyper-parameters, which would train nonsense.
    """

    def __init__(self, fingerprint: str) -> None:
        self.fingerprint = fingerprint

    def setup(self, trainer: Trainer, pl_module: Any, stage: str) -> None:
        """Compare with rank 0. Every rank learns of a difference, so that no rank waits for a rank that has ended."""
        differs = torch.tensor(float(trainer.strategy.broadcast(self.fingerprint) != self.fingerprint))
        if trainer.strategy.reduce(differs.to(trainer.strategy.root_device), reduce_op="sum") > 0:
            remedy = "start one run at a time instead of a sweep that draws for every process"
            raise InputError("all processes of a run must have the same configuration", got="others", remedy=remedy)


class TrainingRecord(Callback):
    """Writes size, wall time, device, best value and end of a training into a JSON file, with each checkpoint.

    A resumed training adds to the time; what a killed one did after its last checkpoint does not count.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._before, self._start = 0.0, time.monotonic()

    def on_train_start(self, trainer: Trainer, module: Any) -> None:
        """Start the clock; a training that goes on is not finished any more."""
        self._start = time.monotonic()
        self._write(trainer, module)

    def on_save_checkpoint(self, trainer: Trainer, module: Any, checkpoint: dict[str, Any]) -> None:
        """Write the file."""
        self._write(trainer, module)

    def on_train_end(self, trainer: Trainer, module: Any) -> None:
        """Write that the training has reached its end; signals and errors do not get here."""
        self._write(trainer, module, is_finished=True)

    def state_dict(self) -> dict[str, float]:
        """Seconds from the first step, validations included, as a checkpoint keeps them."""
        return {"seconds": self._before + time.monotonic() - self._start}

    def load_state_dict(self, state: dict[str, float]) -> None:
        """Restore the time."""
        self._before = state["seconds"]

    def _write(self, trainer: Trainer, module: Any, is_finished: bool = False) -> None:
        if not trainer.is_global_zero:
            return
        device = trainer.strategy.root_device
        values = [each.best_model_score for each in trainer.checkpoint_callbacks if isinstance(each, BestCheckpoint)]
        record = {
            "n_parameters": sum(parameter.numel() for parameter in module.net.parameters()),
            **self.state_dict(),
            "device": torch.cuda.get_device_name(device) if device.type == "cuda" else device.type,
            "processes": trainer.world_size,
            "best_value": next((float(value) for value in values if value is not None), None),
            "is_finished": is_finished,
        }
        atomic.write_text(self.path, json.dumps(record, indent=1) + "\n")


class StopOnSigterm(Callback):
    """Writes a checkpoint to `path` and ends the training after the step in which a process got SIGTERM.

    Under DDP, Lightning's own handler starts a broadcast. Another process may be in the exchange of gradients at that
    time, and both would wait for ever. Here the handler only sets a flag, which the processes share after each step.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.received = False

    def setup(self, trainer: Trainer, pl_module: Any, stage: str) -> None:
        """Take the place of Lightning's handler, which is private, before the trainer registers it."""
        trainer._signal_connector._sigterm_notifier_fn = self._note  # type: ignore

    def on_train_batch_end(self, trainer: Trainer, pl_module: Any, outputs: Any, batch: Any, batch_idx: int) -> None:
        """Stop if any process has the flag."""
        if trainer.strategy.reduce_boolean_decision(self.received, all=False):
            trainer.save_checkpoint(self.path)
            # Lightning kills the first process without a word when another one ends with an error.
            raise SystemExit(STATUS if trainer.is_global_zero else 0)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.received = True


ERROR_GAIN = 4
"""Factor of errors in pictures, which are hard to see otherwise: a sixteenth of the range becomes a quarter."""
GAP = 4


def side_by_side(labels: Tensor, stack: Tensor) -> Tensor:
    """A row for each plane: label, prediction, and errors times ERROR_GAIN, [K, C, H, W] twice -> [C, K H, 3 W]."""
    truth, guess = (images.detach().float().cpu().nan_to_num().clamp(0, 1) for images in (labels, stack))
    errors = (ERROR_GAIN * (guess - truth).abs()).clamp(0, 1)
    return torch.cat([torch.cat(list(column), dim=-2) for column in (truth, guess, errors)], dim=-1)


def log_picture(logger: Any, picture: Tensor, step: int, caption: str = "", name: str = PICTURE) -> None:
    """Give a picture [C, H, W] to a logger that takes pictures (wandb, tensorboard)."""
    if hasattr(logger, "log_image"):
        # wandb expects values up to 255, also in floating point.
        pixels = (255 * picture.permute(1, 2, 0)).round().byte().numpy()
        shown = [pixels if pixels.shape[2] > 1 else pixels[..., 0]]
        logger.log_image(name, shown, step=step, caption=[caption])
    elif hasattr(logger.experiment, "add_image"):
        logger.experiment.add_image(name, picture, step)


class _Continued(ExperimentWriter):
    """Lightning's writer deletes an existing log; this writer appends to it."""

    def _check_log_dir_exists(self) -> None:
        path = Path(self.metrics_file_path)
        if path.is_file():
            with path.open(newline="", encoding="utf-8") as file:
                self.metrics_keys = next(csv.reader(file), [])


class CSVLogger(loggers.CSVLogger):
    """Lightning's CSV logger, which here continues the existing log of a resumed run."""

    @property
    @rank_zero_experiment
    def experiment(self) -> _ExperimentWriter:
        """The writer of the file."""
        if self._experiment is None:
            self._experiment = _Continued(log_dir=self.log_dir)
        return self._experiment


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes checkpoints under a temporary name and renames them: a killed run leaves the last whole checkpoint."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write plain containers and tensors to a file, which is replaced as a whole or not at all."""
        tensor_files.write_checkpoint(path, checkpoint)
