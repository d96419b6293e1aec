"""What the corrections share: estimates of a light field, computed on first use, and the interface of a defect.

Letters: `V U` view rows and columns, `H W` pixels.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

from lfref.captures import brightness, registration
from lfref.captures.brightness import Ratios
from lfref.captures.registration import Registration
from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range
from lfref.refocus.focus.slope_range import CoarseDisparity, ReducedViews


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of a light field that several defects are derived from.

    Raises:
        InputError: A white picture of another grid or size, or of encoded samples beside linear light.

    Example:
        >>> estimates = Estimates(LightField(torch.rand(5, 5, 3, 64, 80)))
        >>> estimates.disparity.shape, estimates.confidence.shape
        (torch.Size([64, 80]), torch.Size([64, 80]))
    """

    field: LightField
    white: LightField | None = None
    """Picture of an evenly lit white surface by the same camera."""

    def __post_init__(self) -> None:
        white, field = self.white, self.field
        if white is None:
            return
        if (white.grid, white.size) != (field.grid, field.size):
            expected = f"the white picture must have the {describe_shape(field)} of {field.name or 'the light field'}"
            remedy = "read both with the same reader options, or leave white= out"
            raise InputError(expected, got=describe_shape(white), remedy=remedy)
        if field.is_linear and not white.is_linear:
            remedy = "read both with the same reader.encoding"
            raise InputError("the white picture must hold linear light", got="encoded samples", remedy=remedy)

    @cached_property
    def reduced(self) -> ReducedViews:
        """Small grey views on a cross through the centre, without smooth differences in brightness."""
        return slope_range.reduce_views(self.field.views, self.field.weight, self.field.positions)

    @cached_property
    def coarse_disparity(self) -> CoarseDisparity:
        """Disparity and confidence of the reduced reference view; takes milliseconds."""
        return slope_range.disparity_of_reduced(self.reduced)

    @property
    def reference(self) -> tuple[int, int]:
        """Row and column of the view that the maps belong to: the central one; 7, 7 of 14x14."""
        return self.reduced.indices[0]

    @cached_property
    def disparity(self) -> Tensor:
        """Disparity of the reference view, pixels per view step, [H, W].

        Reduced pixels are repeated, not interpolated: no value lies between two surfaces.
        """
        return self._enlarged(self.coarse_disparity.disparity)

    @cached_property
    def confidence(self) -> Tensor:
        """Confidence of the disparity, [0, 1]; above 1/2 its standard error is below .03 reduced pixels, [H, W]."""
        return self._enlarged(self.coarse_disparity.confidence)

    @cached_property
    def ratios(self) -> Ratios:
        """Brightness of every view over that of the reference view, per window."""
        return brightness.ratios(self.field, self.disparity, self.reference)

    @cached_property
    def registration(self) -> Registration | None:
        """Displacements of patches and the shifts of views that explain them; None: too few views or patches."""
        return registration.register(self.field, self.disparity, self.reference)

    def _enlarged(self, small: Tensor) -> Tensor:
        # The last reduced row and column also cover the rest up to the border.
        rows, columns = (
            (torch.arange(length) // self.coarse_disparity.factor).clamp(max=n - 1)
            for length, n in zip(self.field.size, small.shape, strict=True)
        )
        return small[rows][:, columns]


def describe_shape(field: LightField) -> str:
    """Grid and size for messages."""
    return f"{field.grid[0]}x{field.grid[1]} views of {field.size[0]}x{field.size[1]} pixels"


@runtime_checkable
class Defect(Protocol):
    """An estimated defect: a frozen dataclass of numbers, texts, tuples of them, and tensors."""

    name: ClassVar[str]
    """Its name in reports and files."""
    needs_light: ClassVar[bool]
    """Whether it measures or scales light: samples that are still encoded do not allow that."""

    def reason_to_skip(self) -> str | None:
        """Why nothing is corrected; None: `corrected` does something."""

    def summary(self) -> str:
        """The estimate in one line, with units, and what remains unknown."""

    def corrected(self, field: LightField) -> LightField:
        """A light field of the same grid and size without the defect; called only without a reason to skip."""
