"""What every way to refocus has in common: (light field or views, slopes) -> stack.

A refocuser has a name, says which planes and which grid of views it is made for, respects the weight of samples, and
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
from lfref.io.scratch import Room
from lfref.lightfield import LightField
from lfref.refocus import batches

Aperture = Callable[[Sequence[int]], Tensor]
"""(grid (V, U)) -> weight of each view, [V, U]."""
KINDS_OF_LIGHT = {True: "linear light", False: "samples as files hold them"}
"""By whether they are linear."""


class Refocuser(abc.ABC):
    """A named way to refocus."""

    name: str
    """As tables and legends call it."""
    planes: FocalPlanes | None = None
    """The only planes that it makes; None: any."""
    grid: tuple[int, int] | None = None
    """The only view rows and columns (V, U) that it reads; None: any."""
    is_linear: bool | None = None
    """Whether it was made for linear light, or for samples as files hold them; None: whatever comes."""

    @property
    def takes_positions(self) -> bool:
        """Whether cameras may stand off the even grid."""
        return False

    def __call__(self, light: LightField | Tensor, slopes: Slopes | None = None) -> Tensor:
        """Refocus.

        Args:
            light: A light field, or views [..., V, U, C, H, W] in floating point, uint8 or uint16.
            slopes: Planes to focus on, in pixels per view step, [N]; None takes the only ones that it makes.

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
            wanted, got = (KINDS_OF_LIGHT[is_linear] for is_linear in (not light.is_linear, light.is_linear))
            remedy = "read it with encoding=none" if light.is_linear else "read it without encoding=none"
            raise InputError(f"{self.name} was trained on {wanted}", got=got, remedy=remedy)
        return self.stack(light.views, light.weight, self.slopes(slopes), light.positions)

    @abc.abstractmethod
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """Refocus views whose axes, type and slopes are known to be usable.

        Args:
            views: [..., V, U, C, H, W].
            weight: How far each sample is to be trusted, in [0, 1], [..., V, U, 1, H, W]; None means fully.
            slopes: In pixels per view step, [N].
            positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

        Raises:
            InputError: Positions that it does not take.
        """

    def through(self, aperture: Aperture | None) -> "Refocuser":
        """The same, looking through an aperture if it can; what has weights of its own, or none, stays as it is.

        Args:
            aperture: Weights of the views, whatever their grid; None: no other.
        """
        return self

    def to(self, device: torch.device) -> "Refocuser":
        """Itself, its weights on a device, if it has any.

        Args:
            device: That of the views.
        """
        return self

    def cell_width(self, slopes: Tensor) -> float:
        """Pixels that the area of a view's cell blurs the blurriest plane by; 0 where views are points.

        Args:
            slopes: Of the planes, in pixels per view step, [N].
        """
        return 0.0

    def reach(self, slopes: Tensor, field: LightField) -> int | None:
        """How many pixels away a sample may count for a pixel; None: all of the picture may.

        Args:
            slopes: Of the planes, in pixels per view step, [N].
            field: What is to be refocused.
        """
        return None

    def slopes(self, asked: Slopes | None) -> Tensor:
        """The slopes asked for, once they are known to be among those that it makes, float64, [N].

        Args:
            asked: In pixels per view step, [N]; None takes the only ones that it makes.

        Raises:
            InputError: It makes others, or any, so that they must be said.
        """
        if self.planes is None and asked is None:
            raise InputError(f"{self.name} refocuses to any planes", got="none", remedy="give slopes")
        if self.planes is None:
            return torch.as_tensor(asked, dtype=torch.float64)
        if asked is not None and not self.planes.has_slopes(asked):
            raise InputError(
                f"{self.name} makes the planes {', '.join(self.planes.labels)}",
                got=", ".join(FocalPlanes(asked).labels),
                remedy="leave the planes as it was trained, or use an operator (method=shift_and_sum)",
            )
        return self.planes.slopes


def check_for_network(name: str, views: Tensor, positions: Tensor | None, device: torch.device) -> None:
    """Refuse views that a network cannot read.

    Args:
        name: Of the method.
        views: Floating point, [..., V, U, C, H, W].
        positions: Of the cameras, as in `Refocuser.stack`.
        device: Of the network.

    Raises:
        InputError: Cameras off the even grid, views on another device, or views that are not finite.
    """
    if positions is not None:
        raise uneven(name)
    if views.device != device:
        raise InputError(f"views must be on the network's device, {device}", got=views.device)
    if not bool(views.isfinite().all()):
        raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file, or give it a weight")


def uneven(name: str) -> InputError:
    """What is raised where cameras do not stand on the even grid that a method needs.

    Args:
        name: Of the method.
    """
    return InputError(
        f"{name} needs cameras on an even grid",
        got="positions of their own",
        remedy="take method=shift_and_sum_through_cells, shift_and_sum, exact_fourier or tilt_shift",
    )


def name_apart(refocusers: Iterable[Refocuser]) -> None:
    """Add a number, in place, to the names of refocusers that occur before.

    Args:
        refocusers: In the order in which they keep their names.
    """
    taken: set[str] = set()
    for each in refocusers:
        candidates = (each.name if count == 1 else f"{each.name} ({count})" for count in itertools.count(1))
        each.name = next(name for name in candidates if name not in taken)
        taken.add(each.name)


# PART bands
# Large light fields, refocused in bands of rows: the same pictures to the bit, in the memory that a band takes.


def in_bands(
    refocuser: Refocuser, field: LightField, slopes: Tensor, n_rows: int, room: Room, device: torch.device
) -> Tensor:
    """The stack of a light field that may be larger than memory.

    Args:
        refocuser: One whose pixels depend on the samples around them and no others.
        field: Its views may lie on a disk.
        slopes: Of the planes, in pixels per view step, float64, [N].
        n_rows: Rows of pixels of a band, at least 1.
        room: Where the stack shall lie.
        device: Where bands are refocused.

    Returns:
        Float32, on the CPU, [N, C, H, W].

    Raises:
        InputError: A method that looks at the whole picture, or slopes that it cannot use.
    """
    reach = refocuser.reach(slopes, field)
    if reach is None:
        what = f"{refocuser.name} of samples with weights" if field.weight is not None else refocuser.name
        raise InputError(
            "bands are for methods whose pixels depend on those around them",
            got=f"{what}, which looks at the whole picture",
            remedy="take method=shift_and_sum, shift_and_sum_cubic or shift_and_sum_cubic_fill, or leave rows out",
        )
    height, width = field.size
    n_read = min(height, n_rows + 2 * reach)
    stack = torch.from_numpy(room((len(slopes), field.views.shape[2], height, width), "float32"))
    for first in range(0, height, n_rows):
        last = min(first + n_rows, height)
        top = min(max(first - reach, 0), height - n_read)
        band = field.crop(top, 0, n_read, width).to(device)
        stack[:, :, first:last] = refocuser(band, slopes)[:, :, first - top : last - top].cpu()
    return stack
