"""The interface that all refocusing methods share: (light field or views, slopes) -> stack.

A refocuser has a name, states the planes and the view grid that it is made for, respects the weight of samples, and
takes views in floating point, uint8 or uint16.
Letters: `V U` view rows and columns, `N` planes, `C H W` channel, pixel row and column.
"""

import abc
import itertools
from collections.abc import Callable, Iterable, Sequence

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.geometry import FocalPlanes, Slopes
from lfref.io.scratch import Allocator
from lfref.lightfield import LightField
from lfref.refocus import batches

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

        Raises:
            InputError: Views or slopes that it cannot use.
        """
        if not isinstance(light, LightField):
            batches.check(light)
            return self.stack(light, None, self.slopes(slopes))
        batches.check(light.views)
        if self.is_linear not in (None, light.is_linear):
            kinds = ["linear light", "samples as files hold them"]
            trained, got = kinds if self.is_linear else reversed(kinds)
            remedy = "read it with encoding=none" if light.is_linear else "read it without encoding=none"
            raise InputError(f"{self.name} was trained on {trained}", got=got, remedy=remedy)
        return self.stack(light.views, light.weight, self.slopes(slopes), light.positions)

    @abc.abstractmethod
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """Refocus views whose axes, type and slopes have been checked.

        Args:
            views: [..., V, U, C, H, W].
            weight: How far each sample is to be trusted, in [0, 1], [..., V, U, 1, H, W]; None means fully.
            slopes: In pixels per view step, [N].
            positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

        Raises:
            InputError: Positions that it does not take.
        """

    def through(self, aperture: Aperture | None) -> "Refocuser":
        """This method with an aperture; itself if it has one already, or cannot weigh views.

        Args:
            aperture: Weights of the views of any grid; None changes nothing.
        """
        return self

    def to(self, device: torch.device) -> "Refocuser":
        """Move its weights, if it has any, to a device; returns itself."""
        return self

    def cell_width(self, slopes: Tensor) -> float:
        """Largest width in pixels of the blur of a view's cell over the planes; 0 for views of no extent."""
        return 0.0

    def reach(self, slopes: Tensor, field: LightField) -> int | None:
        """Largest distance in pixels between a pixel and the samples that it depends on; None: unlimited."""
        return None

    def slopes(self, requested: Slopes | None) -> Tensor:
        """The slopes to refocus to, float64, [N].

        Args:
            requested: In pixels per view step, [N]; None: those of `planes`.

        Raises:
            InputError: The network has other planes, or the method takes any planes and none are given.
        """
        if self.planes is None and requested is None:
            raise InputError(f"{self.name} refocuses to any planes", got="none", remedy="give slopes")
        if self.planes is None:
            return torch.as_tensor(requested, dtype=torch.float64)
        if requested is not None and not self.planes.has_slopes(requested):
            raise InputError(
                f"{self.name} makes the planes {', '.join(self.planes.labels)}",
                got=", ".join(FocalPlanes(requested).labels),
                remedy="leave the planes as it was trained, or use an operator (method=shift_and_sum)",
            )
        return self.planes.slopes


RANGE = 1e6
"""Largest ratio of a sample to the bright ones, at which single precision is off by 0.1 times the bright ones."""


def check_for_network(name: str, views: Tensor, positions: Tensor | None, device: torch.device) -> None:
    """Refuse views that the network of a method cannot read.

    Raises:
        InputError: Cameras off the even grid, views on another device, views that are not finite, or a sample that
            exceeds `RANGE` times the bright ones.
    """
    if positions is not None:
        raise uneven(name)
    if views.device != device:
        raise InputError(f"views must be on the network's device, {device}", got=views.device)
    if not bool(views.isfinite().all()):
        raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file, or give it a weight")
    # Candidates come from spectra, which round to 1e-7 of the largest sample everywhere in the picture.
    some = views.flatten()[:: max(1, views.numel() // 10**6)].abs()
    bright, largest = float(some.quantile(0.99)), views.abs().argmax()
    if 0 < RANGE * bright < float(views.flatten()[largest].abs()):
        place = tuple(int(index) for index in torch.unravel_index(largest, views.shape)[-5:])
        expected = f"{name} needs samples below {RANGE:.0e} times the bright ones ({bright:.3g})"
        got = f"{float(views.flatten()[largest]):.3g} at (v, u, channel, y, x) = {place}"
        raise InputError(expected, got=got, remedy="mend that sample, or refocus with method=shift_and_sum")


def uneven(name: str) -> InputError:
    """The error about cameras off the even grid, for a method that needs one."""
    return InputError(
        f"{name} needs cameras on an even grid",
        got="positions of their own",
        remedy="take method=shift_and_sum_through_cells, shift_and_sum, exact_fourier or tilt_shift",
    )


def name_apart(refocusers: Iterable[Refocuser]) -> None:
    """Number the names of refocusers that occur more than once, in place: `name`, `name (2)`, ..."""
    used: set[str] = set()
    for refocuser in refocusers:
        name = refocuser.name
        numbered = (f"{name} ({count})" for count in itertools.count(2))
        refocuser.name = next(new for new in itertools.chain([name], numbered) if new not in used)
        used.add(refocuser.name)


def in_bands(
    refocuser: Refocuser, field: LightField, slopes: Tensor, n_rows: int, allocate: Allocator, device: torch.device
) -> Tensor:
    """The stack of a light field larger than memory, refocused band by band, bit-equal to that of the whole.

    Args:
        refocuser: One with a limited `reach`.
        field: A light field, whose views may lie on a disk.
        slopes: Of the planes, in pixels per view step, float64, [N].
        n_rows: Rows of pixels of a band, at least 1.
        allocate: Allocates the stack.
        device: Where bands are refocused.

    Returns:
        Float32, on the CPU, [N, C, H, W].

    Raises:
        InputError: A method whose reach is unlimited, or slopes that it cannot use.
    """
    reach = refocuser.reach(slopes, field)
    if reach is None:
        method = f"{refocuser.name} of samples with weights" if field.weight is not None else refocuser.name
        raise InputError(
            "bands are for methods whose pixels depend on those around them",
            got=f"{method}, which looks at the whole picture",
            remedy="take method=shift_and_sum, shift_and_sum_cubic or shift_and_sum_cubic_fill, or leave rows out",
        )
    height, width = field.size
    # All bands are read with equal height, so that operators plan the same sums for each.
    n_read = min(height, n_rows + 2 * reach)
    stack = torch.from_numpy(allocate((len(slopes), field.views.shape[2], height, width), "float32"))
    for first in range(0, height, n_rows):
        last = min(first + n_rows, height)
        top = min(max(first - reach, 0), height - n_read)
        band = field.crop(top, 0, n_read, width).to(device)
        stack[:, :, first:last] = refocuser(band, slopes)[:, :, first - top : last - top].cpu()
    return stack
