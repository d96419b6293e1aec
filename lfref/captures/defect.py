"""What every correction is: what it needs, what it found, when it is inert, and what it then does.

The simulator's plan turned round: there effects are put onto views where a scene calls for them, here they are taken
off where a capture shows them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from lfref.captures import brightness
from lfref.captures.brightness import Ratios
from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range
from lfref.refocus.focus.slope_range import CoarseDisparity, ReducedViews

# PART evidence
# What is known of a light field before anything is corrected: found once, when it is asked for, and shared.
#
# Everything here is a glance at a few reduced views, and takes milliseconds.
# Letters: `V U` views, `H W` pixels, `h w` reduced pixels.


@dataclass(frozen=True, eq=False)
class Evidence:
    """Facts about a light field.

    Raises:
        InputError: A white picture of another grid or size, or of encoded samples beside linear light.

    Example:
        >>> evidence = Evidence(LightField(torch.rand(5, 5, 3, 64, 80)))
        >>> evidence.disparity.shape, evidence.confidence.shape
        (torch.Size([64, 80]), torch.Size([64, 80]))
    """

    field: LightField
    """What is looked at."""
    white: LightField | None = None
    """The same camera's picture of an evenly lit white surface, if there is one."""

    def __post_init__(self) -> None:
        if self.white is not None:
            _check_white(self.white, self.field)

    @cached_property
    def reduced(self) -> ReducedViews:
        """Views on a cross through the centre, grey and small, smooth differences in brightness taken out."""
        return slope_range.reduce_views(self.field.views, self.field.weight, self.field.positions)

    @cached_property
    def glance(self) -> CoarseDisparity:
        """Disparity and confidence of the reduced reference view."""
        return slope_range.disparity_of_reduced(self.reduced)

    @property
    def reference(self) -> tuple[int, int]:
        """Row and column of the view that the maps belong to: the central one, 7, 7 of 14x14."""
        return self.reduced.indices[0]

    @cached_property
    def disparity(self) -> Tensor:
        """Of what each pixel of the reference shows, in pixels per view step, [H, W].

        Found on reduced pixels (`glance.factor` along each side) and repeated: no value lies between two surfaces.
        """
        return self._whole(self.glance.disparity)

    @cached_property
    def confidence(self) -> Tensor:
        """How sure the disparity is, [0, 1], [H, W]; above 1/2 its standard error is below .03 reduced pixels."""
        return self._whole(self.glance.confidence)

    @cached_property
    def ratios(self) -> Ratios:
        """Brightness of every view beside that of the reference, window by window."""
        return brightness.ratios(self.field, self.disparity, self.reference)

    def _whole(self, small: Tensor) -> Tensor:
        """Reduced pixels repeated; the last row and column go on to the border."""
        rows, columns = (
            (torch.arange(n) // self.glance.factor).clamp(max=most - 1)
            for n, most in zip(self.field.size, small.shape, strict=True)
        )
        return small[rows][:, columns]


def _check_white(white: LightField, field: LightField) -> None:
    if (white.grid, white.size) != (field.grid, field.size):
        expected = f"the white picture must have the {shape_told(field)} of {field.name or 'the light field'}"
        remedy = "read both with the same reader options, or leave white= out"
        raise InputError(expected, got=shape_told(white), remedy=remedy)
    if field.is_linear and not white.is_linear:
        remedy = "read both with the same reader.encoding"
        raise InputError("the white picture must hold linear light", got="encoded samples", remedy=remedy)


def shape_told(field: LightField) -> str:
    """Grid and size as messages say them.

    Args:
        field: Of that grid and size.
    """
    return f"{field.grid[0]}x{field.grid[1]} views of {field.size[0]}x{field.size[1]} pixels"


@runtime_checkable
class Finding(Protocol):
    """What was found of one defect: a frozen dataclass of plain numbers, texts, tuples of them, and tensors."""

    name: ClassVar[str]
    """As it is called in explanations and files."""

    def inert(self) -> str | None:
        """Why nothing is to be corrected; None if something is."""

    def told(self) -> str:
        """What was found, in one line, with units, and what of it cannot be known."""

    def corrected(self, field: LightField) -> LightField:
        """The field without the defect; itself stays as it is. Never called where inert.

        Args:
            field: Of the grid and size that the finding is of.
        """


class Correction(NamedTuple):
    """How one defect is found."""

    kind: type[Finding]
    """Of the findings."""
    needs: str
    """What it takes of a light field, for explanations."""
    find: Callable[[Evidence], Finding]
    """What is wrong; inert where the evidence does not reach."""
    needs_light: bool = False
    """Whether it measures and scales light, which samples as files encode them are not."""
