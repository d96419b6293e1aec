"""The LightningModule: a network with its loss, metrics, optimiser and schedule, also across a resume."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import torch
from lightning.pytorch import LightningModule
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import CyclicLR, LambdaLR, LRScheduler, OneCycleLR
from torchmetrics import Metric

from lfref.data.crops import Batch
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.losses.composite import CompositeLoss
from lfref.metrics.stack import GROUPS, MPSNR, MSSIM, Explained
from lfref.nets import checkpoint as checkpoints
from lfref.nets.network import Network

OptimizerFactory = Callable[[list[dict[str, Any]]], Optimizer]
SchedulerFactory = Callable[[Optimizer], LRScheduler]
EXPLAINED = {group: "val/explained" if group == "all" else f"val/explained_{group}" for group in GROUPS}
"""Names under which the share explained is logged, by the group of planes."""
LEARNING_RATE = "train/lr"
LOSS, MPSNR_OF_STACK, MSSIM_OF_STACK = "loss", "val/mpsnr", "val/mssim"
"""Names of logged values: `train/loss` and `val/loss`, and the quality of the stacks of validation."""


class Refocusing(LightningModule):
    """Trains a network to make refocused stacks: views [B, V, U, C, H, W] and slopes [N] -> stack [B, N, C, H, W].

    Args:
        net: The network.
        loss: Named weighted terms.
        planes: Planes of the labels; they go into every checkpoint, as `is_linear` does.
        optimizer: Function that makes the optimiser of groups of parameters.
        scheduler: Function that makes the schedule of an optimiser's rate.
        end_rate: Learning rate of the network's first and last layers, as a share of the rate of the others. Inputs of
            RefNet's last convolution are positive and large: one step of Adam at the full rate would move an output
            by more than the range of most pictures.
        is_linear: Whether the data are linear light or encoded samples.
        metrics: Further metrics of validation, logged by their names as `val/NAME`.
    """

    def __init__(
        self,
        net: Network,
        loss: CompositeLoss,
        planes: FocalPlanes,
        optimizer: OptimizerFactory,
        scheduler: SchedulerFactory | None = None,
        end_rate: float = 1.0,
        is_linear: bool = True,
        metrics: Mapping[str, Metric] | None = None,
    ) -> None:
        super().__init__()
        checkpoints.check_number(net, planes)
        self.net: Any = net
        self.optimizer = optimizer
        self.scheduler = scheduler
        self.metrics: Any = nn.ModuleDict(metrics or {})
        self.end_rate = end_rate
        self.loss = loss
        self.planes = planes
        self.is_linear = is_linear
        self.mpsnr = MPSNR(n_planes=len(planes))
        self.mssim = MSSIM(n_planes=len(planes))
        self.explained = nn.ModuleList(Explained(planes.values, group) for group in GROUPS)

    def parameter_groups(self) -> list[list[nn.Parameter]]:
        """Parameters of the network in groups; the second one, its first and last layers, learns at `end_rate`."""
        ends = [] if self.end_rate == 1 else list(self.net.ends())
        slow = {id(parameter) for parameter in ends}
        others = [parameter for parameter in self.net.parameters() if id(parameter) not in slow]
        return [others, ends] if ends else [others]

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """The loss of one batch; every term is logged by its name."""
        return self._loss(batch["labels"], self.net(batch["views"], batch["slopes"]), "train")

    def validation_step(self, batch: Batch, batch_index: int) -> Tensor:
        """The stack of one held-out batch; its loss and metrics are logged."""
        stack = self.net(batch["views"], batch["slopes"])
        self._loss(batch["labels"], stack, "val")
        for name, metric in ((MPSNR_OF_STACK, self.mpsnr), (MSSIM_OF_STACK, self.mssim)):
            metric.update(stack, batch["labels"])
            self.log(name, metric, prog_bar=True)
        mean = batch["views"].mean((1, 2))
        for group, share in zip(GROUPS, self.explained, strict=True):
            assert isinstance(share, Explained)
            if any(share.planes):
                share.update(stack, batch["labels"], mean)
                self.log(EXPLAINED[group], share, prog_bar=group == "all")
        self.update_metrics(stack, batch["labels"])
        return stack

    def on_validation_epoch_end(self) -> None:
        """Log the MPSNR of each plane, over all processes."""
        names = plane_names(self.planes)
        # `per_plane` has the stacks of all processes: their mean, which Lightning wants to take, changes nothing.
        self.log_dict(dict(zip(names, self.mpsnr.per_plane(), strict=True)), sync_dist=True)

    def payload(self) -> dict[str, Any]:
        """Entry of checkpoints from which `lfref.load` builds the network again: its arguments and its planes."""
        return checkpoints.payload(self.net, self.planes, self.is_linear)

    def update_metrics(self, images: Tensor, truth: Tensor) -> None:
        """Update the further metrics with validation images [..., C, H, W], clamped to [0, 1], and log them."""
        pair = [each.flatten(0, -4).float().clamp(0, 1) for each in (images, truth)]
        for name, metric in self.metrics.items():
            metric.update(*pair)
            self.log(f"val/{name}", metric)

    def log_stage(self, stage: str, values: Mapping[str, Tensor], batch_size: int) -> None:
        """Log means over all processes as `STAGE/NAME`: for `train` of a step, for `val` of the epoch."""
        is_step, named = stage == "train", {f"{stage}/{name}": value for name, value in values.items()}
        self.log_dict(named, on_step=is_step, on_epoch=not is_step, batch_size=batch_size, sync_dist=True)

    def configure_optimizers(self) -> dict[str, Any]:  # type: ignore[override]
        """The optimiser over all parameters of the network, and its schedule."""
        optimizer, schedule = self._optimization(self.parameter_groups())
        stepped = {"scheduler": schedule, "interval": interval_of(schedule)}
        return {"optimizer": optimizer} | ({"lr_scheduler": stepped} if schedule else {})

    def on_before_optimizer_step(self, optimizer: Optimizer) -> None:
        """Log the learning rate here: after the step, a schedule may have changed it."""
        self.log(LEARNING_RATE, float(optimizer.param_groups[0]["lr"]))

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add what `lfref.load` needs."""
        checkpoint["lfref"] = self.payload()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Use this run's settings of optimiser and schedule, not the checkpoint's."""
        loop = checkpoint["loops"]["fit_loop"]
        epochs, is_whole = loop["epoch_progress"]["current"], loop["epoch_loop.batch_progress"]["is_last_batch"]
        # After the last batch of an epoch, Lightning goes on with the next one, without a step of the schedule.
        n_steps = {"epoch": epochs["started" if is_whole else "processed"], "step": checkpoint["global_step"]}
        optimizer, schedule = self._optimization([[nn.Parameter(torch.zeros(()))] for _ in self.parameter_groups()])
        refit(checkpoint, optimizer, schedule, n_steps[interval_of(schedule)])

    def _loss(self, labels: Tensor, stack: Tensor, stage: str) -> Tensor:
        terms = self.loss.terms(stack, labels)
        total = self.loss.total(terms)
        self.log_stage(stage, {LOSS: total, **terms}, len(labels))
        return total

    def _optimization(self, groups: list[list[nn.Parameter]]) -> tuple[Optimizer, LRScheduler | None]:
        optimizer = self.optimizer([{"params": group} for group in groups])
        for group in optimizer.param_groups[1:]:
            group["lr"] *= self.end_rate
        return optimizer, self.scheduler(optimizer) if self.scheduler else None


def plane_names(planes: FocalPlanes) -> list[str]:
    """Names under which the MPSNR of each plane is logged, such as `val/mpsnr_plane/alpha_0.5`."""
    return [f"{MPSNR_OF_STACK}_plane/{label.replace(' ', '_')}" for label in planes.labels]


def interval_of(schedule: LRScheduler | None) -> str:
    """When a schedule is stepped: each `step` if its length is a number of steps, else each `epoch`."""
    return "step" if isinstance(schedule, WarmupCosine | OneCycleLR | CyclicLR) else "epoch"


class WarmupCosine(LambdaLR):
    """Each group's learning rate rises along a line in a share of all steps, `warmup`, and falls to 0 as a cosine."""

    def __init__(self, optimizer: Optimizer, total_steps: int, warmup: float = 0.05) -> None:
        if total_steps < 1:  # such as trainer.max_steps=-1
            raise InputError("a cosine by step needs the last step", got=total_steps, remedy="give trainer.max_steps")
        n_warm = max(1, round(warmup * total_steps))

        def factor(step: int) -> float:
            done = min(1.0, (step - n_warm) / max(1, total_steps - n_warm))
            return (step + 1) / (n_warm + 1) if step < n_warm else (1 + math.cos(math.pi * done)) / 2

        super().__init__(optimizer, factor)


def refit(checkpoint: dict[str, Any], optimizer: Optimizer, schedule: LRScheduler | None, n_steps: int) -> None:
    """Replace the settings of optimiser and schedule in a checkpoint of Lightning, in place; the moments stay.

    The new schedule repeats the `n_steps` of the old one, as if its settings held from the start.
    """
    if schedule is not None:
        for _ in range(n_steps):
            optimizer.step()  # a schedule that is stepped before its optimiser warns
            schedule.step()
    checkpoint["lr_schedulers"] = [] if schedule is None else [schedule.state_dict()]
    for saved in checkpoint["optimizer_states"]:
        for group, settings in zip(saved["param_groups"], optimizer.param_groups, strict=True):
            group.update({name: value for name, value in settings.items() if name != "params"})
