"""The angular grid and the focus parameter: alpha <-> slope, view offsets, and their legal ranges.

Letters: `u v` view column and row, `x y` pixel column and row, `s` slope in pixels per view step.
Every other room takes slopes only; alphas are turned into slopes here and nowhere else.
Source: Ng, "Light Field Photography with a Hand-held Plenoptic Camera", 2005 (convention `ng`).
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError, chosen

Slopes = Tensor | Sequence[float]
"""Slopes in pixels per view step, [N]."""


class Convention(NamedTuple):
    """One meaning of alpha: how it becomes a slope, and back."""

    to_slope: Callable[[float], float]
    to_alpha: Callable[[float], float]


CONVENTIONS: dict[str, Convention] = {
    # The magnification x/alpha of Ng's formula is left out, so that the planes of a stack are registered.
    "ng": Convention(lambda alpha: 1 - 1 / alpha, lambda slope: 1 / (1 - slope)),
    "parallel": Convention(lambda alpha: alpha - 1, lambda slope: slope + 1),
}


def slopes(alphas: Iterable[float], convention: str = "ng") -> Tensor:
    """Slopes of the focal planes that these alphas name.

    Args:
        alphas: Relative focal distances, finite and above 0, [N].
        convention: `ng` (s = 1 - 1/alpha) or `parallel` (s = alpha - 1).

    Returns:
        Slopes in pixels per view step, float64, [N].

    Raises:
        InputError: An alpha is not finite or not above 0, there is none, or the convention is unknown.
    """
    to_slope = chosen("convention", convention, CONVENTIONS).to_slope
    checked = checked_alphas(alphas)
    values = torch.tensor([to_slope(alpha) for alpha in checked], dtype=torch.float64)
    if not bool(values.isfinite().all()):
        raise InputError("alpha must be far enough from 0 for a finite slope", got=list(checked))
    return values


def even_slopes(n_planes: int, first: float = -1.0, last: float = 1.0) -> Tensor:
    """Slopes an equal step apart.

    Args:
        n_planes: Number of planes, >= 1; a single one lies midway.
        first: Slope of the first plane, in pixels per view step.
        last: Slope of the last plane, in pixels per view step.

    Returns:
        Slopes in pixels per view step, float64, [n_planes].

    Raises:
        InputError: No plane, or an end that is not finite.
    """
    if n_planes < 1 or not (math.isfinite(first) and math.isfinite(last)):
        raise InputError(
            "an even grid needs n_planes >= 1 and finite ends", got=f"{n_planes} planes from {first} to {last}"
        )
    if n_planes == 1:
        return torch.tensor([(first + last) / 2], dtype=torch.float64)
    return torch.linspace(first, last, n_planes, dtype=torch.float64)


def checked_alphas(alphas: Iterable[float]) -> tuple[float, ...]:
    """The alphas as plain numbers, once they are known to be usable.

    Args:
        alphas: Should be finite and above 0, at least one.

    Raises:
        InputError: They are not, or are no list of numbers.
    """
    try:
        values = tuple(float(alpha) for alpha in alphas)
    except (TypeError, ValueError) as error:
        raise InputError(
            "alphas must be a list of numbers", got=repr(alphas), remedy="for example [0.5,1,2]"
        ) from error
    if not values:
        raise InputError("alphas must name at least one focal plane", got="an empty list")
    for alpha in values:
        if not (math.isfinite(alpha) and alpha > 0):
            raise InputError("alpha must be finite and above 0", got=alpha, remedy="alpha = 1 is the captured focus")
    return values


def angular_offsets(n_views: int) -> Tensor:
    """Distance of each view from the angular centre, u - u0 with u0 = (n - 1) / 2.

    Args:
        n_views: Number of views along one angular axis.

    Returns:
        Offsets in view steps, float64, [n_views].
    """
    return torch.arange(n_views, dtype=torch.float64) - (n_views - 1) / 2


def corner_shift(slopes: Tensor, grid: Sequence[int]) -> float:
    """Largest shift, in pixels along one axis, that any view undergoes at these slopes.

    Args:
        slopes: Slopes in pixels per view step, [N].
        grid: Number of view rows and columns (V, U).
    """
    return float(slopes.abs().max()) * (max(grid) - 1) / 2


def checked_slopes(slopes: Slopes, grid: Sequence[int], size: Sequence[int]) -> Tensor:
    """The slopes as float64 on the CPU, once they are known to be usable.

    Args:
        slopes: Slopes in pixels per view step, [N] (or one number).
        grid: Number of view rows and columns (V, U).
        size: Height and width (H, W) of a view in pixels.

    Returns:
        The slopes, float64, CPU, [N].

    Raises:
        InputError: No slope, one that is not finite, or a corner shift of half a view or more.
    """
    values = torch.as_tensor(slopes, dtype=torch.float64, device="cpu").detach().reshape(-1)
    if values.numel() == 0 or not bool(values.isfinite().all()):
        raise InputError("slopes must be finite and at least one", got=values.tolist())
    for n_views, length, axis in zip(grid, size, ("height", "width"), strict=True):
        if (shift := corner_shift(values, (n_views,))) > 0 and shift >= length / 2:
            raise InputError(
                f"the outermost view must shift by less than half the {axis} ({length / 2:g} px)",
                got=f"{shift:g} px at slope {float(values[values.abs().argmax()]):g}",
                remedy="use alphas nearer to 1, or larger views",
            )
    return values


@dataclass(frozen=True)
class FocalPlanes:
    """The planes of a refocused stack: alphas and what they mean."""

    alphas: tuple[float, ...]
    """Relative focal distances, finite and above 0, [N]."""
    convention: str = "ng"
    """Meaning of alpha, a key of `CONVENTIONS`."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "alphas", checked_alphas(self.alphas))
        slopes(self.alphas, self.convention)

    def __len__(self) -> int:
        return len(self.alphas)

    @property
    def slopes(self) -> Tensor:
        """Slopes in pixels per view step, float64, [N]."""
        return slopes(self.alphas, self.convention)

    def as_dict(self) -> dict[str, object]:
        """Plain containers that rebuild this object, as a checkpoint stores them."""
        return {"alphas": list(self.alphas), "convention": self.convention}
