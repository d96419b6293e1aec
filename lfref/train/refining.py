"""The training of refiners: planes that a method has made, and what is missing to them."""

from typing import Any

import torch
from torch import Tensor

from lfref.data.plane_data import PlaneBatch
from lfref.data.plane_sets import Recipe
from lfref.functional.psnr import psnr
from lfref.losses.relative import RelativeError
from lfref.nets.refiner import Refiner
from lfref.refocuser import refined
from lfref.refocuser.guides import check
from lfref.train.fitting import Fitting, OptimizerFactory, SchedulerFactory


class Refining(Fitting):
    """Trains a refiner.

    Args:
        net: Guides, pictures and doubts -> better pictures.
        loss: Of refined pictures, truth, pictures and doubts.
        recipe: Of the planes that it learns from; its method and guides go into every checkpoint.
        optimizer: Makes the optimiser from the parameters.
        scheduler: Makes the schedule of its learning rate, stepped each step; None keeps the rate.

    Raises:
        InputError: Corrections cannot be mixed of the guides of the recipe.
    """

    interval = "step"

    def __init__(
        self,
        net: Refiner,
        loss: RelativeError,
        recipe: Recipe,
        optimizer: OptimizerFactory,
        scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(net, optimizer, scheduler)
        check(recipe.guides, net.n_offers)
        self.loss = loss
        self.recipe = recipe

    def training_step(self, batch: PlaneBatch, batch_index: int) -> Tensor:
        """The loss of one batch."""
        return self._loss(batch, self(batch["guides"], batch["pictures"], batch["doubts"]), "train")

    def validation_step(self, batch: PlaneBatch, batch_index: int) -> None:
        """The loss, PSNR and what it gained, of one held-out light field, logged."""
        made = self(batch["guides"], batch["pictures"], batch["doubts"])
        self._loss(batch, made, "val")
        truth = batch["pictures"] + batch["missing"]
        # Where nothing may be corrected there is nothing to judge.
        shown = (torch.where(batch["doubts"] > 0, each, truth) for each in (made, batch["pictures"]))
        after, before = (psnr(each, truth).mean() for each in shown)
        values = {"val/mpsnr": after, "val/gain": after - before}
        self.log_dict(values, prog_bar=True, batch_size=len(truth), sync_dist=True)

    def payload(self) -> dict[str, Any]:
        """What builds the refiner again, its method and its guides."""
        return refined.payload(self.net, self.recipe.base, self.recipe.guides)

    def _loss(self, batch: PlaneBatch, made: Tensor, stage: str) -> Tensor:
        loss: Tensor = self.loss(made, batch["pictures"] + batch["missing"], batch["pictures"], batch["doubts"])
        self.log_stage(stage, {"loss": loss}, len(made))
        return loss
