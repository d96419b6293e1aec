"""Refocusing operators as refocusers: any planes, any grid, samples counted by their weight."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus import apertures, batches
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.focal_stack_transform import focal_stack_transform
from lfref.refocus.fourier.super_resolution import super_resolve
from lfref.refocus.homography import homography, slope_homographies
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocus.shift.shift_and_sum import reach as sum_reach
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells
from lfref.refocuser import filling
from lfref.refocuser.refocuser import Aperture, Refocuser, uneven

Operator = Callable[..., Tensor]
"""(views [..., V, U, C, H, W], slopes [N], weights=[V, U] with an aperture) -> stack [..., N, C, H, W]."""


@dataclass(eq=False)
class OperatorRefocuser(Refocuser):
    """A refocusing operator, perhaps with an aperture.

    Args:
        name: As tables and legends call it.
        operator: Refocuses views at slopes; its options are bound already.
        aperture: Weights of the views of any grid; None weighs all alike.

    Raises:
        InputError: An aperture for an operator without a parameter `weights`.

    Example:
        >>> refocuser = OperatorRefocuser("shift_and_sum", lfref.shift_and_sum)
        >>> refocuser(torch.rand(3, 3, 3, 16, 16), [-0.5, 0, 0.5]).shape
        torch.Size([3, 3, 16, 16])
    """

    name: str
    operator: Operator
    aperture: Aperture | None = None

    def __post_init__(self) -> None:
        self.function = getattr(self.operator, "func", self.operator)
        """The operator without the options bound to it."""
        self.options: dict[str, Any] = getattr(self.operator, "keywords", {})
        """The options bound to it."""
        try:
            self._parameters = inspect.signature(self.operator).parameters.keys() - self.options.keys()
        except ValueError:  # functions written in C may have no signature
            self._parameters = set()
        if self.aperture is not None and not self.takes("weights"):
            if getattr(self.aperture, "func", self.aperture) is not apertures.full:
                raise InputError(f"{self.name} must have a parameter weights to look through an aperture", got="none")
            self.aperture = None  # without weights all views count alike anyway

    def takes(self, parameter: str) -> bool:
        """Whether the operator has a parameter that is not bound already."""
        return parameter in self._parameters

    @property
    def takes_positions(self) -> bool:
        """As in `Refocuser`, by the operator's parameters."""
        return self.takes("positions")

    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The operator's stack, samples counted by their weight, black where no trusted one contributes.

        If the weight is constant within each view, which includes missing views, it is an aperture. Otherwise linear
        operators give the weighted mean of the samples, and operators that compare the views get them filled.
        """
        if positions is not None and not self.takes("positions"):
            raise uneven(self.name)
        options = {} if positions is None else {"positions": positions}
        if self.aperture is not None:
            options["weights"] = self.aperture(tuple(views.shape[-5:-3]))
        if weight is None:
            return self.operator(views, slopes, **options)
        of_views = filling.view_weights(weight) if self.takes("weights") else None
        if of_views is not None and bool(of_views.any()):
            return self._through_views(views, slopes, of_views, options)
        radiance = batches.radiance(views)
        sample = self._of_filled if self.function in COMPARING else self._weighted_mean
        return sample(radiance, weight.to(radiance), slopes, options).to(batches.stack_dtype(views))

    def through(self, aperture: Aperture | None) -> "OperatorRefocuser":
        """As in `Refocuser`."""
        stays = aperture is None or self.aperture is not None or not self.takes("weights")
        return self if stays else replace(self, aperture=aperture)

    def cell_width(self, slopes: Tensor) -> float:
        """As in `Refocuser`, by the operator's `fill` and `disparity`."""
        disparity = torch.as_tensor(self.options.get("disparity", 0.0), dtype=torch.float64).reshape(-1, 1)
        return float(self.options.get("fill", 0.0) * (slopes.cpu() - disparity.cpu()).abs().max())

    def reach(self, slopes: Tensor, field: LightField) -> int | None:
        """As in `Refocuser`; None for weighted samples, since weights are compared with the picture's largest."""
        if self.function is not shift_and_sum or field.weight is not None:
            return None
        parameters = inspect.signature(sum_reach).parameters
        options = {name: value for name, value in self.options.items() if name in parameters}
        return sum_reach(slopes, field.grid, positions=field.positions, **options)

    def _weighted_mean(self, views: Tensor, weight: Tensor, slopes: Tensor, options: dict[str, Tensor]) -> Tensor:
        """Sum of the weighted samples over the sum of the weights."""
        share = self.operator(weight, slopes, **options)
        weighted = self.operator(views * weight, slopes, **options)
        # Interpolation by more than two samples gives some of them negative weight. Division by a sum near 0 would
        # leave light and dark dots, so such pixels are black.
        least = filling.LEAST * share.detach().amax((-3, -2, -1), keepdim=True)
        least = least.clamp(min=torch.finfo(share.dtype).tiny)
        return torch.where(share > least, weighted / torch.maximum(share, least), 0.0)

    def _of_filled(self, views: Tensor, weight: Tensor, slopes: Tensor, options: dict[str, Tensor]) -> Tensor:
        """The stack of views whose untrusted samples are filled, black where no trusted sample is reached."""
        is_trusted = filling.trusted(weight)
        whole = filling.extended(filling.filled(views, weight), is_trusted)
        is_there = (weight.reshape(-1, *weight.shape[-5:]) > 0).any(0).flatten(2).any(2)
        if bool(is_there.all()) or not (bool(is_there.any()) and self.takes("weights")):
            stack = self.operator(whole, slopes, **options)
        else:
            stack = self._through_views(whole, slopes, is_there.to(views), options)
        if bool(is_trusted.any(-5).any(-4).all()):
            return stack
        # The stack may be finer than the views, or a single picture.
        share = shift_and_sum(is_trusted.to(weight), slopes, positions=options.get("positions"))
        if stack.shape[-4] != share.shape[-4]:
            share = share.amax(-4, keepdim=True)
        share = F.interpolate(share.flatten(0, -4), stack.shape[-2:], mode="bilinear").unflatten(0, share.shape[:-3])
        return torch.where(share > filling.LEAST * share.amax((-3, -2, -1), keepdim=True), stack, 0.0)

    def _through_views(self, views: Tensor, slopes: Tensor, weights: Tensor, options: dict[str, Tensor]) -> Tensor:
        """The stack through an aperture of these weights, [V, U], 0 for missing views."""
        if bool((weights == weights[0, 0]).all()):
            return self.operator(views, slopes, **options)
        if self.function in PREDICTING and not bool((weights > 0).all()):
            whole = filling.predicted(batches.radiance(views), weights)
            return self.operator(whole, slopes, **options).to(batches.stack_dtype(views))
        if "weights" in options:
            weights = options["weights"] * weights.to(options["weights"])
        return self.operator(views, slopes, **options | {"weights": weights})


def even_stack(views: Tensor, slopes: Tensor) -> Tensor:
    """The focal stack transform: as many planes, evenly spaced between the least and the largest slope."""
    return focal_stack_transform(views, len(slopes), float(slopes.min()), float(slopes.max()))


def coplanar_homography(views: Tensor, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
    """Shift-and-sum written as one homography for each view and plane."""
    return homography(views, slope_homographies(slopes, (views.shape[-5], views.shape[-4]), positions))


def focus(views: Tensor, slopes: Tensor) -> Tensor:
    """The all-in-focus picture of a linear shift-and-sum, as a stack of one plane."""
    return all_in_focus(shift_and_sum(views, slopes)).image.unsqueeze(-4)


PREDICTING: frozenset[Operator] = frozenset({refocus_by_layers, occlusion_aware})
"""Operators that estimate the record of the whole aperture: missing views are predicted for them."""
COMPARING: frozenset[Operator] = PREDICTING | {shift_and_sum_through_cells, super_resolve, focus}
"""Operators that compare the views before they sum them, which weighted views would mislead."""
