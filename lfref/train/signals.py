"""SIGTERM in a training: all processes stop after the same step, with a checkpoint.

Under DDP, Lightning's own handler starts a broadcast. Another process may be in the exchange of gradients at that time,
and both would wait for ever. Here the handler only sets a flag, which the processes share after each step.
"""

from pathlib import Path
from types import FrameType
from typing import Any

from lightning.pytorch import Callback, Trainer

STATUS = 143
"""Exit status of a process that SIGTERM ends, as shells count it."""


class StopOnSigterm(Callback):
    """Writes a checkpoint and ends the training after the step in which a process got SIGTERM.

    Args:
        path: The checkpoint to write.
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
