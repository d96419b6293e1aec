"""The training of networks that make whole stacks of views: the network, its loss, its metrics."""

from typing import Any

from torch import Tensor

from lfref.data.patches import Batch
from lfref.geometry import FocalPlanes
from lfref.losses.composite import CompositeLoss
from lfref.metrics.stack import MPSNR, MSSIM
from lfref.nets import checkpoint as checkpoints
from lfref.nets.network import Network
from lfref.train.fitting import Fitting, OptimizerFactory, SchedulerFactory


class Refocusing(Fitting):
    """Trains a network to make refocused stacks.

    Args:
        net: Views [B, V, U, C, H, W] and slopes [N] -> stack [B, N, C, H, W].
        loss: Named weighted terms.
        planes: What the planes of the labels are; goes into every checkpoint.
        optimizer: Makes the optimiser from the parameters.
        scheduler: Makes the schedule of its learning rate, stepped each epoch; None keeps the rate.
        is_linear: Whether the data is linear light, or samples as files hold them; goes into every checkpoint.

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
        is_linear: bool = True,
    ) -> None:
        super().__init__(net, optimizer, scheduler)
        checkpoints.check_number(net, planes)
        self.loss = loss
        self.planes = planes
        self.is_linear = is_linear
        self.mpsnr = MPSNR(n_planes=len(planes))
        self.mssim = MSSIM(n_planes=len(planes))

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

    def payload(self) -> dict[str, Any]:
        """What builds the network again, and what its planes are."""
        return checkpoints.payload(self.net, self.planes, self.is_linear)

    def _loss(self, labels: Tensor, stack: Tensor, stage: str) -> Tensor:
        terms = self.loss.terms(stack, labels)
        total = self.loss.total(terms)
        self.log_stage(stage, {"loss": total, **terms}, len(labels))
        return total
