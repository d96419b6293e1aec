"""The interface that all refocusing methods share: (light field or views, slopes) -> stack.

A refocuser has a name, states the planes and the view grid that it is made for, respects the weight of samples, and
takes views in floating point, uint8 or uint16. `OperatorRefocuser` is that of an operator: any planes, any grid.
Letters: `V U` view rows and columns, `N` planes, `C H W` channel, pixel row and column.
"""

import abc
import functools
import inspect
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import torch
from torch import Tensor, nn

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import FocalPlanes, Slopes
from lfref.lightfield import LightField
from lfref.refocus import batches
from lfref.refocus.operator import traits
from lfref.refocus.scene import Scene
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import filling

Aperture = Callable[[Sequence[int]], Tensor]
"""(grid (V, U)) -> weight of each view, [V, U]."""


class Refocuser(abc.ABC):
    """A named way to refocus."""

    name: str
    """As tables and legends call it."""
    planes: FocalPlanes | None = None
    """Planes that it makes, no others; None: any planes."""
    grid: tuple[int, int] | None = None
    """View rows and columns (V, U) that it reads, no others; None: any."""
    is_linear: bool | None = None
    """Whether it was trained on linear light or on encoded samples; None: it takes both."""
    device: torch.device | None = None
    """Device that it runs on, to which views are moved, and the stack back; None: that of the views."""
    is_network: bool = False
    """Whether it has learned; all others are classical."""
    module: nn.Module | None = None
    """Its weights, if it has any."""

    @property
    def takes_positions(self) -> bool:
        """Whether cameras may stand off the even grid."""
        return False

    def __call__(self, light: LightField | Tensor, slopes: Slopes | None = None) -> Tensor:
        """Refocus.

        Args:
            light: A light field, or views [..., V, U, C, H, W] in floating point, uint8 or uint16.
            slopes: Planes to focus on, in pixels per view step, [N]; None: those of `planes`.

        Returns:
            Stack, [..., N, C, H, W], type of the views (float32 for integers).
        """
        views = light.views if isinstance(light, LightField) else light
        if self.device is not None and isinstance(views, Tensor) and views.device != self.device:
            return self(light.to(self.device), slopes).to(views.device)
        if not isinstance(light, LightField):
            batches.check(light)
            return self.stack(light, None, self.slopes(slopes))
        batches.check(light.views)
        if self.is_linear not in (None, light.is_linear):
            kinds = ["linear light", "samples as files hold them"]
            trained, got = kinds if self.is_linear else reversed(kinds)
            remedy = "set reader.encoding=none" if light.is_linear else "leave reader.encoding=none out"
            raise InputError(f"{self.name} was trained on {trained}", got=got, remedy=remedy)
        views = light.views if light.weight is None else filling.readable(light.views, light.weight)
        return self.stack(views, light.weight, self.slopes(slopes), light.positions)

    @abc.abstractmethod
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """Refocus views [..., V, U, C, H, W] whose axes, type and slopes [N] have been checked.

        The weight is the trust in samples, in [0, 1] (None: 1), positions are those of a `LightField`.
        """

    def through(self, aperture: Aperture | None) -> "Refocuser":
        """This method with an aperture; itself if it has one already, or cannot weigh views, or for None."""
        return self

    def of_scene(self, scene: Scene) -> "Refocuser":
        """This method for the one light field of a scene, of which several stacks share what is estimated."""
        return self

    def to(self, device: torch.device) -> Self:
        """Move its weights, if it has any, to a device; returns itself."""
        if self.module is not None:
            self.module.to(device)
        return self

    def cell_width(self, slopes: Tensor) -> float:
        """Largest width in pixels of the blur of a view's cell over the planes; 0 for views of no extent."""
        return 0.0

    def slopes(self, requested: Slopes | None) -> Tensor:
        """The slopes to refocus to, float64, [N]; None requests those of `planes`."""
        if self.planes is None:
            if requested is None:
                raise InputError(f"{self.name} refocuses to any planes", got="none", remedy="give slopes")
            return geometry.as_slopes(requested)
        if requested is not None and not self.planes.has_slopes(requested):
            got, remedy = ", ".join(FocalPlanes(requested).labels), "ask for these planes, or use method=shift_and_sum"
            raise InputError(f"{self.name} makes the planes {', '.join(self.planes.labels)}", got=got, remedy=remedy)
        return self.planes.slopes


def light_for_network(
    name: str, views: Tensor, weight: Tensor | None, positions: Tensor | None, device: torch.device
) -> Tensor:
    """The radiance that a network reads, untrusted samples filled; uneven grids, other devices and NaN are refused."""
    if positions is not None:
        raise uneven(name)
    if views.device != device:
        raise InputError(f"views must be on the network's device, {device}", got=views.device)
    radiance = batches.radiance(views)
    batches.check_finite(radiance, "mend the file, or give samples weight 0")
    return radiance if weight is None else filling.filled(radiance, weight.to(radiance))


def uneven(name: str) -> InputError:
    """The error about cameras off the even grid, for a method that needs one."""
    remedy = "take method=shift_and_sum_antialiased, shift_and_sum, exact_fourier or tilt_shift"
    return InputError(f"{name} needs cameras on an even grid", got="positions of their own", remedy=remedy)


def name_apart(refocusers: Iterable[Refocuser]) -> None:
    """Number the names of refocusers that occur more than once, in place: `name`, `name (2)`, ..."""
    used: set[str] = set()
    for refocuser in refocusers:
        name = refocuser.name
        numbered = (f"{name} ({count})" for count in itertools.count(2))
        refocuser.name = next(new for new in itertools.chain([name], numbered) if new not in used)
        used.add(refocuser.name)


Operator = Callable[..., Tensor]
"""(views [..., V, U, C, H, W], slopes [N], weights=[V, U] with an aperture) -> stack [..., N, C, H, W]."""


@dataclass(eq=False)
class OperatorRefocuser(Refocuser):
    """A refocusing operator, perhaps with an aperture, for which it must have a parameter `weights`.

    Args:
        name: As tables and legends call it.
        operator: Refocuses views at slopes; its options are bound already.
        aperture: Weights of the views of any grid; None weighs all alike.

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
        self.traits = traits(self.operator)
        self.options: dict[str, Any] = getattr(self.operator, "keywords", {})
        """The options bound to it."""
        self._parameters = inspect.signature(self.operator).parameters.keys() - self.options.keys()
        if self.aperture is not None and not self.takes("weights"):
            raise InputError(f"{self.name} must have a parameter weights to look through an aperture", got="none")

    def takes(self, parameter: str) -> bool:
        """Whether the operator has a parameter that is not bound already."""
        return parameter in self._parameters

    @property
    def takes_positions(self) -> bool:
        """As in `Refocuser`, by the operator's parameters."""
        return self.takes("positions")

    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The operator's stack, samples counted by their weight, black where no trusted one contributes."""
        if positions is not None and not self.takes("positions"):
            raise uneven(self.name)
        options = {} if positions is None else {"positions": positions}
        if self.aperture is not None:
            options["weights"] = self.aperture(tuple(views.shape[-5:-3]))
        if weight is None:
            return self.operator(views, slopes, **options)
        # A weight that is constant within each view, which includes missing views, is an aperture. Otherwise linear
        # operators give the weighted mean of the samples, and operators that compare the views get them filled.
        of_views = filling.view_weights(weight) if self.takes("weights") else None
        if of_views is not None and bool(of_views.any()):
            return self._through_views(views, slopes, of_views, options)
        radiance = batches.radiance(views)
        sample = self._weighted_mean if self.traits.reads == "sums" else self._of_filled
        return sample(radiance, weight.to(radiance), slopes, options).to(batches.stack_dtype(views))

    def through(self, aperture: Aperture | None) -> "OperatorRefocuser":
        """As in `Refocuser`."""
        stays = aperture is None or self.aperture is not None or not self.takes("weights")
        return self if stays else replace(self, aperture=aperture)

    def of_scene(self, scene: Scene) -> "OperatorRefocuser":
        """As in `Refocuser`; itself if it needs no estimates, or looks through an aperture, which changes them."""
        stays = self.aperture is not None or not self.takes("scene")
        return self if stays else replace(self, operator=functools.partial(self.operator, scene=scene))

    def cell_width(self, slopes: Tensor) -> float:
        """As in `Refocuser`, by the operator's `fill_factor` and `disparity`."""
        distances = slopes.cpu() - self.options.get("disparity", 0.0)
        return float(self.options.get("fill_factor", 0.0) * distances.abs().max())

    def _weighted_mean(self, views: Tensor, weight: Tensor, slopes: Tensor, options: dict[str, Tensor]) -> Tensor:
        """Sum of the weighted samples over the sum of the weights."""
        share = self.operator(weight, slopes, **options)
        # Of large light fields a few channels at a time: the product needs as much memory as its factor.
        n_channels = max(1, AT_ONCE // (views.numel() // views.shape[-3]))
        parts = [self.operator(part * weight, slopes, **options) for part in views.split(n_channels, -3)]
        weighted = parts[0] if len(parts) == 1 else torch.cat(parts, -3)
        # Interpolation by more than two samples gives some of them negative weight. Division by a sum near 0 would
        # leave light and dark dots, so such pixels are black.
        least = filling.LEAST * share.detach().amax((-3, -2, -1), keepdim=True)
        least = least.clamp(min=torch.finfo(share.dtype).tiny)
        return torch.where(share > least, weighted / torch.maximum(share, least), 0.0)

    def _of_filled(self, views: Tensor, weight: Tensor, slopes: Tensor, options: dict[str, Tensor]) -> Tensor:
        """The stack of views whose untrusted samples are filled, black where no trusted sample is reached."""
        whole = filling.filled(views, weight)
        whole = filling.extended(whole, filling.trusted(weight), in_place=whole is not views)
        is_there = (weight.reshape(-1, *weight.shape[-5:]) > 0).any(0).flatten(2).any(2)
        if bool(is_there.all()) or not (bool(is_there.any()) and self.takes("weights")):
            stack = self.operator(whole, slopes, **options)
        else:
            stack = self._through_views(whole, slopes, is_there.to(views), options, in_place=whole is not views)
        del whole  # it is as large as the views
        is_trusted = filling.trusted(weight)
        if bool(is_trusted.any(-5).any(-4).all()):
            return stack
        share = shift_and_sum(is_trusted.to(weight), slopes, positions=options.get("positions"))
        return torch.where(share > filling.LEAST * share.amax((-3, -2, -1), keepdim=True), stack, 0.0)

    def _through_views(
        self, views: Tensor, slopes: Tensor, weights: Tensor, options: dict[str, Tensor], in_place: bool = False
    ) -> Tensor:
        """The stack through an aperture of these weights, [V, U], 0 for missing views, which may be filled in place."""
        if bool((weights == weights[0, 0]).all()):
            return self.operator(views, slopes, **options)
        fits = not self.traits.symmetric or batches.is_symmetric(weights)
        if self.traits.reads == "predicts" and not (fits and bool((weights > 0).all())):
            whole = filling.predicted(batches.radiance(views), weights, in_place)
            return self.operator(whole, slopes, **options).to(batches.stack_dtype(views))
        if "weights" in options:
            weights = options["weights"] * weights.to(options["weights"])
        return self.operator(views, slopes, **options | {"weights": weights})


AT_ONCE = 2**26
"""Samples that are weighted at once, 256 MB: 9x9 views of 380x550 pixels in three channels are fewer."""
