"""What every training module has in common: its optimiser and schedule, also across a resume."""

import abc
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import torch
from lightning.pytorch import LightningModule
from torch import Tensor, nn
from torch.optim.lr_scheduler import LRScheduler

from lfref.errors import InputError
from lfref.train import resume

OptimizerFactory = Callable[[Iterator[nn.Parameter]], torch.optim.Optimizer]
SchedulerFactory = Callable[[torch.optim.Optimizer], LRScheduler]


class Fitting(LightningModule, abc.ABC):
    """Fits a network.

    Args:
        net: The network.
        optimizer: Makes the optimiser from the parameters.
        scheduler: Makes the schedule of its learning rate; None keeps the rate.
    """

    interval: ClassVar[str] = "epoch"
    """What the schedule is stepped by: each epoch, or each step."""

    def __init__(self, net: nn.Module, optimizer: OptimizerFactory, scheduler: SchedulerFactory | None = None) -> None:
        super().__init__()
        self.net: Any = net
        self.optimizer = optimizer
        self.scheduler = scheduler

    @abc.abstractmethod
    def payload(self) -> dict[str, Any]:
        """What a checkpoint must hold besides the weights, so that `lfref.load` can use them."""

    def forward(self, *inputs: Tensor) -> Tensor:
        """The network's."""
        made: Tensor = self.net(*inputs)
        return made

    def configure_optimizers(self) -> dict[str, Any]:  # type: ignore[override]
        """The optimiser over all parameters of the network, and its schedule.

        Raises:
            InputError: Their settings do not fit them.
        """
        optimizer, schedule = self._optimization(self.net.parameters())
        stepped = {"scheduler": schedule, "interval": self.interval}
        return {"optimizer": optimizer} | ({"lr_scheduler": stepped} if schedule else {})

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add what `lfref.load` needs."""
        checkpoint["lfref"] = self.payload()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Go on with the rate and the schedule that are set now; a checkpoint brings those of its own run."""
        done = {
            "epoch": checkpoint["loops"]["fit_loop"]["epoch_progress"]["current"]["processed"],
            "step": checkpoint["global_step"],
        }
        made = self._optimization(iter([nn.Parameter(torch.zeros(()))]))
        resume.refit(checkpoint, *made, done[self.interval])

    def log_stage(self, stage: str, values: Mapping[str, Tensor], batch_size: int) -> None:
        """Log values as `STAGE/NAME`: of training each step, of validation their mean over the epoch.

        Args:
            stage: `train` or `val`.
            values: By name.
            batch_size: What they are means over.
        """
        named = {f"{stage}/{name}": value for name, value in values.items()}
        self.log_dict(named, on_step=stage == "train", on_epoch=stage == "val", batch_size=batch_size, sync_dist=True)

    def _optimization(self, parameters: Iterator[nn.Parameter]) -> tuple[torch.optim.Optimizer, LRScheduler | None]:
        try:
            optimizer = self.optimizer(parameters)
            return optimizer, self.scheduler(optimizer) if self.scheduler else None
        except (TypeError, ValueError, ZeroDivisionError) as error:
            raise InputError("optimizer and scheduler must have settings that fit them", got=error) from error
