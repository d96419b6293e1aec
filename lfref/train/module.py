"""The LightningModule: a network, its loss, its metrics and its optimiser, and nothing they could do themselves."""

from collections.abc import Callable, Iterator
from typing import Any

import torch
from lightning.pytorch import LightningModule
from torch import Tensor, nn
from torch.optim.lr_scheduler import LRScheduler

from lfref.data.patches import Batch
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.losses.composite import CompositeLoss
from lfref.metrics.stack import MPSNR, MSSIM
from lfref.nets import checkpoint as checkpoints
from lfref.nets.network import Network
from lfref.train import resume

OptimizerFactory = Callable[[Iterator[nn.Parameter]], torch.optim.Optimizer]
SchedulerFactory = Callable[[torch.optim.Optimizer], LRScheduler]


class Refocusing(LightningModule):
    """Trains a network to make refocused stacks.

    Args:
        net: Views [B, V, U, C, H, W] and slopes [N] -> stack [B, N, C, H, W].
        loss: Named weighted terms.
        planes: What the planes of the labels are; goes into every checkpoint.
        optimizer: Makes the optimiser from the parameters.
        scheduler: Makes the schedule of its learning rate, stepped each epoch; None keeps the rate.

    Raises:
        InputError: The network makes another number of planes.
    """

    def __init__(
        self,
        net: Network,
        loss: CompositeLoss,
        planes: FocalPlanes,
        optimizer: OptimizerFactory,
        scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__()
        checkpoints.check_number(net, planes)
        self.net = net
        self.loss = loss
        self.planes = planes
        self.optimizer = optimizer
        self.scheduler = scheduler
        self.mpsnr = MPSNR(n_planes=len(planes))
        self.mssim = MSSIM(n_planes=len(planes))

    def forward(self, views: Tensor, slopes: Tensor | None = None) -> Tensor:
        """Refocus: views [B, V, U, C, H, W] and slopes [N] -> stack [B, N, C, H, W]."""
        return self.net(views, slopes)

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """The loss of one batch; every term is logged by its name."""
        return self._loss(batch["labels"], self.net(batch["views"], batch["slopes"]), "train")

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """The stack of one held-out batch, its loss and metrics logged."""
        stack = self.net(batch["views"], batch["slopes"])
        self._loss(batch["labels"], stack, "val")
        for name, metric in (("val/mpsnr", self.mpsnr), ("val/mssim", self.mssim)):
            metric.update(stack, batch["labels"])
            self.log(name, metric, prog_bar=True)
        return stack

    def configure_optimizers(self) -> dict[str, Any]:  # type: ignore[override]
        """The optimiser over all parameters of the network, and its schedule.

        Raises:
            InputError: Their settings do not fit them.
        """
        optimizer, schedule = self._optimization(self.net.parameters())
        return {"optimizer": optimizer} | ({"lr_scheduler": schedule} if schedule else {})

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add what `lfref.load` needs to build the network again."""
        checkpoint["lfref"] = checkpoints.payload(self.net, self.planes)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Go on with the rate and the schedule that are set now; a checkpoint brings those of its own run."""
        resume.refit(checkpoint, *self._optimization(iter([nn.Parameter(torch.zeros(()))])))

    def _optimization(self, parameters: Iterator[nn.Parameter]) -> tuple[torch.optim.Optimizer, LRScheduler | None]:
        try:
            optimizer = self.optimizer(parameters)
            return optimizer, self.scheduler(optimizer) if self.scheduler else None
        except (TypeError, ValueError, ZeroDivisionError) as error:
            raise InputError("optimizer and scheduler must have settings that fit them", got=error) from error

    def _loss(self, labels: Tensor, stack: Tensor, stage: str) -> Tensor:
        terms = self.loss.terms(stack, labels)
        total = self.loss.total(terms)
        values = {f"{stage}/{name}": value for name, value in {"loss": total, **terms}.items()}
        self.log_dict(
            values,
            on_step=stage == "train",
            on_epoch=stage == "val",
            batch_size=len(labels),
            sync_dist=True,
        )
        return total
