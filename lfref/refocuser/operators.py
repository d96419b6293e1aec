"""Refocusing operators as refocusers: any planes, any grid, samples counted by their weight."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.lightfield import LightField
from lfref.refocus import batches
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
"""(views [..., V, U, C, H, W], slopes [N]) -> stack [..., N, C, H, W]; with an aperture, `weights` [V, U] too."""


@dataclass(eq=False)
class OperatorRefocuser(Refocuser):
    """A linear operator, perhaps looking through an aperture.

    Args:
        name: As tables and legends call it.
        operator: Refocuses views at slopes; options already bound.
        aperture: Weights of the views, whatever their grid; None weighs all alike.

    Example:
        >>> refocuser = OperatorRefocuser("shift_and_sum", lfref.shift_and_sum)
        >>> refocuser(torch.rand(3, 3, 3, 16, 16), [-0.5, 0, 0.5]).shape
        torch.Size([3, 3, 16, 16])
    """

    name: str
    operator: Operator
    aperture: Aperture | None = None

    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The operator's stack, samples counted by their weight, black where no trusted one contributes.

        Views that weigh the same throughout, missing ones too, are an aperture. Else linear operators give the weighted
        mean, sample by sample; those that look at the views see them filled, and all samples alike.
        """
        if positions is not None and not self.takes_positions:
            raise uneven(self.name)
        options = {} if positions is None else {"positions": positions}
        if weight is None:
            return self._sum(views, slopes, None, options)
        of_views = filling.of_whole_views(weight) if self._takes("weights") else None
        if of_views is not None and bool(of_views.any()):
            return self._through_views(views, slopes, of_views, options)
        radiance = batches.radiance(views)
        weight = weight.to(radiance)
        if self._looks:
            stack = self._of_filled(radiance, weight, slopes, options)
        else:
            stack = self._mean(radiance, weight, slopes, options)
        return stack.to(batches.stack_dtype(views))

    @property
    def takes_positions(self) -> bool:
        """As in `Refocuser`, by the operator's arguments."""
        return self._takes("positions")

    def through(self, aperture: Aperture | None) -> "OperatorRefocuser":
        """As in `Refocuser`; an aperture of its own is kept."""
        return self if aperture is None or self.aperture is not None else replace(self, aperture=aperture)

    def knowing(self, disparities: Callable[[], Tensor]) -> "OperatorRefocuser":
        """The same, told the disparities of a light field if it can use them: it need not look for them.

        Args:
            disparities: Finds them, [H, W]; not called where they are of no use.
        """
        if not self._takes("disparities"):
            return self
        return replace(self, operator=functools.partial(self.operator, disparities=disparities()))

    def cell_width(self, slopes: Tensor) -> float:
        """As in `Refocuser`, by the operator's `fill` and `disparity`."""
        options = getattr(self.operator, "keywords", {})
        disparity = torch.as_tensor(options.get("disparity", 0.0), dtype=torch.float64).reshape(-1, 1)
        return float(options.get("fill", 0.0) * (slopes.cpu() - disparity.cpu()).abs().max())

    def reach(self, slopes: Tensor, field: LightField) -> int | None:
        """As in `Refocuser`; that of weighted samples is unknown, since weights are compared across the picture."""
        if self._function not in LOCAL or field.weight is not None:
            return None
        local, options = LOCAL[self._function], getattr(self.operator, "keywords", {})
        known = {name: value for name, value in options.items() if name in inspect.signature(local).parameters}
        return local(slopes, field.grid, positions=field.positions, **known)

    def _mean(self, views: Tensor, weight: Tensor, slopes: Tensor, options: dict[str, Tensor]) -> Tensor:
        """The weighted mean, sample by sample; black where the sum of the weights is next to nothing.

        Interpolation by more than two samples weighs some below 0: a quotient by next to nothing is a light or a dark
        dot.
        """
        share = self._sum(weight, slopes, None, options)
        weighted = self._sum(views * weight, slopes, None, options)
        most = share.detach().amax((-3, -2, -1), keepdim=True)
        least = (filling.LEAST * most).clamp(min=torch.finfo(share.dtype).tiny)
        return torch.where(share > least, weighted / torch.maximum(share, least), 0.0)

    def _of_filled(self, views: Tensor, weight: Tensor, slopes: Tensor, options: dict[str, Tensor]) -> Tensor:
        """All samples alike, those that are not to be trusted made up; black where the picture would be made up."""
        is_trusted = filling.trusted(weight)
        whole = filling.extended(filling.filled(views, weight), is_trusted)
        is_there = (weight.reshape(-1, *weight.shape[-5:]) > 0).any(0).flatten(2).any(2)
        if bool(is_there.all()) or not (bool(is_there.any()) and self._takes("weights")):
            stack = self._sum(whole, slopes, None, options)
        else:
            stack = self._through_views(whole, slopes, is_there.to(views), options)
        if bool(is_trusted.any(-5).any(-4).all()):
            return stack
        return torch.where(_is_reached(is_trusted.to(weight), slopes, stack, options), stack, 0.0)

    def _through_views(self, views: Tensor, slopes: Tensor, weights: Tensor, options: dict[str, Tensor]) -> Tensor:
        """Through an aperture of these weights [V, U], or, where missing views can be foretold, through the whole."""
        if bool((weights == weights[0, 0]).all()):
            return self._sum(views, slopes, None, options)
        if self._function not in FORETELLING or bool((weights > 0).all()):
            return self._sum(views, slopes, weights, options)
        whole = filling.foretold(batches.radiance(views), weights)
        return self._sum(whole, slopes, None, options).to(batches.stack_dtype(views))

    def _sum(self, views: Tensor, slopes: Tensor, weights: Tensor | None, options: dict[str, Tensor]) -> Tensor:
        """The operator, through its aperture and these weights of the views, [V, U]."""
        if self.aperture is not None:
            own = self.aperture(tuple(views.shape[-5:-3]))
            weights = own if weights is None else own * weights.to(own)
        return self.operator(views, slopes, **options, **({} if weights is None else {"weights": weights}))

    @property
    def _function(self) -> Operator:
        """The operator without what is bound to it."""
        return getattr(self.operator, "func", self.operator)

    @property
    def _looks(self) -> bool:
        return self._function in LOOKING

    def _takes(self, argument: str) -> bool:
        """Whether the operator can be given an argument that is not bound already."""
        bound = getattr(self.operator, "keywords", {})
        return argument in inspect.signature(self.operator).parameters and argument not in bound


def _is_reached(trust: Tensor, slopes: Tensor, stack: Tensor, options: dict[str, Tensor]) -> Tensor:
    """Which pixels of a stack, be it finer or of one picture, samples that are trusted reach, [..., N, 1, H, W]."""
    share = shift_and_sum(trust, slopes, positions=options.get("positions"))
    if stack.shape[-4] != share.shape[-4]:
        share = share.amax(-4, keepdim=True)
    share = F.interpolate(share.flatten(0, -4), stack.shape[-2:], mode="bilinear").unflatten(0, share.shape[:-3])
    return share > filling.LEAST * share.amax((-3, -2, -1), keepdim=True)


def even_stack(views: Tensor, slopes: Tensor) -> Tensor:
    """The focal stack transform with as many planes between the same extremes.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, in any order, [N].
    """
    return focal_stack_transform(views, len(slopes), float(slopes.min()), float(slopes.max()))


def coplanar_homography(views: Tensor, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
    """Homographies of cameras in one plane, which shift-and-sum needs no matrices for.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, [N].
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.
    """
    return homography(views, slope_homographies(slopes, (views.shape[-5], views.shape[-4]), positions))


def focus(views: Tensor, slopes: Tensor) -> Tensor:
    """The all-in-focus picture of a linear shift-and-sum, as a stack of one.

    Args:
        views: Light fields, [..., V, U, C, H, W].
        slopes: In pixels per view step, [N].
    """
    return all_in_focus(shift_and_sum(views, slopes)).image.unsqueeze(-4)


LOCAL: dict[Operator, Callable[..., int | None]] = {shift_and_sum: sum_reach}
"""How far their pixels see; the others look at the whole picture."""
FORETELLING: frozenset[Operator] = frozenset({refocus_by_layers, occlusion_aware})
"""Estimate what the whole aperture would have seen: missing views are made up for."""
LOOKING: frozenset[Operator] = FORETELLING | {shift_and_sum_through_cells, super_resolve, focus}
"""Look at the views before they sum them: views times weights would mislead them."""
