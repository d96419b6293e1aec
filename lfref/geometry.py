"""The angular grid and the focus parameter: alpha <-> slope, view offsets, legal ranges, cells of an aperture.

Letters: `u v` view column and row, `x y` pixel column and row, `s` slope in pixels per view step.
Planes are slopes; alphas and even ranges are other ways to write them, and only this module converts those.
Source: Ng, "Light Field Photography with a Hand-held Plenoptic Camera", 2005 (convention `ng`).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor

from lfref.errors import InputError, chosen

Slopes = Tensor | Sequence[float]
"""Slopes in pixels per view step, [N]."""


class Convention(NamedTuple):
    """One meaning of alpha: its conversion to a slope, and back."""

    to_slope: Callable[[float], float]
    to_alpha: Callable[[float], float]


CONVENTIONS: dict[str, Convention] = {
    # The magnification x/alpha of Ng's formula is left out, so that the planes of a stack are registered.
    "ng": Convention(lambda alpha: 1 - 1 / alpha, lambda slope: 1 / (1 - slope) if slope != 1 else math.inf),
    "parallel": Convention(lambda alpha: alpha - 1, lambda slope: slope + 1),
}


def slopes(alphas: Iterable[float], convention: str = "ng") -> Tensor:
    """Slopes of the focal planes at these alphas, in pixels per view step, float64, [N].

    Args:
        alphas: Relative focal distances, finite and above 0, [N].
        convention: `ng` (s = 1 - 1/alpha) or `parallel` (s = alpha - 1).

    Example:
        >>> slopes([0.125, 1, 2]).tolist()
        [-7.0, 0.0, 0.5]
    """
    to_slope = chosen("convention", convention, CONVENTIONS).to_slope
    try:
        numbers = [float(alpha) for alpha in alphas]
        values = torch.tensor(
            [to_slope(alpha) if 0 < alpha < math.inf else math.nan for alpha in numbers], dtype=torch.float64
        )
    except (TypeError, ValueError):
        values = torch.empty(0)
    if not len(values) or not bool(values.isfinite().all()):
        remedy = "for example [0.5,1,2]; 1 is the captured focus"
        raise InputError("alphas must be a list of finite numbers above 0", got=repr(alphas), remedy=remedy)
    return values


def even_slopes(n_planes: int, first: float = -1.0, last: float = 1.0) -> Tensor:
    """Slopes an equal step apart, float64, [n_planes]; a single one lies midway."""
    if n_planes < 1 or not all(map(math.isfinite, (first, last))) or not float(n_planes).is_integer():
        got = f"{n_planes} planes from {first} to {last}"
        raise InputError("an even grid needs a whole number of planes and finite ends", got=got)
    if n_planes == 1:
        return torch.tensor([(first + last) / 2], dtype=torch.float64)
    return torch.linspace(first, last, int(n_planes), dtype=torch.float64)


def angular_offsets(n_views: int, device: torch.device | None = None) -> Tensor:
    """Offset of each view from the angular centre, u - u0 with u0 = (n - 1) / 2, in view steps, float64, [n_views]."""
    return torch.arange(n_views, dtype=torch.float64, device=device) - (n_views - 1) / 2


def corner_shift(slopes: Tensor, grid: Sequence[float]) -> float:
    """Largest shift of any view of a grid (V, U) at these slopes, in pixels along one axis."""
    return float(slopes.abs().max()) * (max(grid) - 1) / 2


def as_slopes(slopes: Slopes | float) -> Tensor:
    """Slopes (or one number) as float64 on the CPU, [N]; an InputError unless they are finite numbers."""
    try:
        numbers = np.ascontiguousarray(slopes) if isinstance(slopes, np.ndarray) else slopes
        values = torch.as_tensor(numbers, dtype=torch.float64, device="cpu").detach().reshape(-1)
    except (TypeError, ValueError, RuntimeError):
        values = torch.empty(0)
    if values.numel() == 0 or not bool(values.isfinite().all()):
        raise InputError("slopes must be finite and at least one", got=repr(slopes), remedy="for example [-1,0,0.5]")
    return values


def checked_slopes(slopes: Slopes, grid: Sequence[float], size: Sequence[int]) -> Tensor:
    """The slopes as float64 on the CPU, [N]; an InputError if a corner view shifts by half its size [H, W] or more."""
    if torch.compiler.is_exporting() and isinstance(slopes, Tensor):
        return slopes  # a file gets them when it runs
    values = as_slopes(slopes)
    for n_views, length, axis in zip(grid, size, ("height", "width"), strict=True):
        if (shift := corner_shift(values, (n_views,))) > 0 and shift >= length / 2:
            expected = f"the outermost view must shift by less than half the {axis} ({length / 2:g} px)"
            got = f"{shift:g} px at slope {float(values[values.abs().argmax()]):g}"
            raise InputError(expected, got=got, remedy="set slopes=[...] nearer to 0 (alphas=[...] nearer to 1)")
    return values


@dataclass(frozen=True, init=False)
class FocalPlanes:
    """The planes of a refocused stack: slopes, in the order of the stack; equal if they are equal, however written.

    Args:
        slopes: Finite slopes in pixels per view step, at least one, [N].
        convention: Meaning of alpha, a key of `CONVENTIONS`, if the planes were written as alphas; else None.

    Example:
        >>> FocalPlanes([-1, 0, 0.5]).labels
        ('slope -1', 'slope 0', 'slope 0.5')
    """

    quantity: ClassVar[str] = "slope"
    unit: ClassVar[str] = "px per view step"
    values: tuple[float, ...]
    convention: str | None = field(compare=False)

    def __init__(self, slopes: Slopes, convention: str | None = None) -> None:
        object.__setattr__(self, "values", tuple(as_slopes(slopes).tolist()))
        if convention is not None:
            chosen("convention", convention, CONVENTIONS)
        object.__setattr__(self, "convention", convention)

    def __len__(self) -> int:
        return len(self.values)

    @property
    def slopes(self) -> Tensor:
        """Slopes in pixels per view step, float64, [N]."""
        return torch.tensor(self.values, dtype=torch.float64)

    @property
    def alphas(self) -> tuple[float, ...] | None:
        """Alphas to 12 digits if the planes were written as alphas, else None."""
        if self.convention is None:
            return None
        return tuple(float(f"{CONVENTIONS[self.convention].to_alpha(slope):.12g}") for slope in self.values)

    @property
    def labels(self) -> tuple[str, ...]:
        """Label of each plane, as it was written: `alpha 0.125` or `slope -2`."""
        if self.alphas is None:
            return tuple(f"slope {slope:.4g}" for slope in self.values)
        return tuple(f"alpha {alpha:g}" for alpha in self.alphas)

    @property
    def titles(self) -> tuple[str, ...]:
        """Slope and alpha of each plane: `slope -7, alpha 0.125`; the slope alone if no alpha gives it."""
        to_alpha = CONVENTIONS[self.convention or "ng"].to_alpha
        alphas = (f", alpha {a:.4g}" if 0 < (a := to_alpha(slope)) < math.inf else "" for slope in self.values)
        return tuple(f"slope {slope:.4g}{alpha}" for slope, alpha in zip(self.values, alphas, strict=True))

    def has_slopes(self, slopes: Slopes) -> bool:
        """Whether slopes [N] are those of these planes, up to rounding to float32."""
        values = torch.as_tensor(slopes, dtype=torch.float64, device="cpu").reshape(-1)
        return len(values) == len(self) and torch.allclose(values, self.slopes, rtol=1e-6, atol=1e-6)

    def as_dict(self) -> dict[str, object]:
        """Plain containers for a checkpoint; `planes_from` reads them."""
        return {"slopes": list(self.values), "convention": self.convention}


def planes_at_alphas(alphas: Iterable[float], convention: str = "ng") -> FocalPlanes:
    """Planes that are written as alphas; arguments are those of `slopes`.

    Example:
        >>> planes_at_alphas([0.125, 1, 2]).slopes.tolist()
        [-7.0, 0.0, 0.5]
    """
    return FocalPlanes(slopes(alphas, convention), convention)


def even_planes(n: int = 16, first: float = -1.0, last: float = 1.0) -> FocalPlanes:
    """`n` planes whose slopes are an equal step apart from `first` to `last`.

    Example:
        >>> even_planes(5, -2, 2).values
        (-2.0, -1.0, 0.0, 1.0, 2.0)
    """
    return FocalPlanes(even_slopes(n, first, last))


def planes_from(plain: Mapping[str, Any]) -> FocalPlanes:
    """Planes from the plain containers of `FocalPlanes.as_dict`."""
    return FocalPlanes(plain.get("slopes", ()), plain.get("convention"))


N_STRIPS = 4096
"""Number of strips into which a disc or a polygon is cut: areas are exact to 1e-6 of the figure."""


def covered_by_disc(rows: Tensor, columns: Tensor, radius: float = 1.0) -> Tensor:
    """Area [J, I] that a disc about 0 covers of each cell, between rising edges of rows [J + 1] and columns [I + 1]."""
    # Horizontal strips, which are narrow at the top and the bottom of the disc.
    strips = -radius * torch.linspace(0, torch.pi, N_STRIPS + 1, dtype=torch.float64).cos()
    half_chord = (radius**2 - ((strips[1:] + strips[:-1]) / 2).square()).sqrt()
    return overlap(strips[:-1], strips[1:], rows).T @ overlap(-half_chord, half_chord, columns)


def covered_by_polygon(rows: Tensor, columns: Tensor, n_corners: int, radius: float = 1.0, turn: float = 0.0) -> Tensor:
    """Area [J, I] of a regular polygon about 0 in each cell, as `covered_by_disc`; `turn` is a corner's angle."""
    heights = [radius * math.sin(turn + 2 * corner * math.pi / n_corners) for corner in range(n_corners)]
    strips = torch.linspace(min(heights), max(heights), N_STRIPS + 1, dtype=torch.float64)
    middles = (strips[1:] + strips[:-1]) / 2
    left, right = torch.full_like(middles, -radius), torch.full_like(middles, radius)
    for side in range(n_corners):
        # The points p inside of a side have p.(across, down) <= near.
        angle = turn + (2 * side + 1) * math.pi / n_corners
        across, down, near = math.cos(angle), math.sin(angle), radius * math.cos(math.pi / n_corners)
        # A horizontal side bounds no strip; a division by a tiny number of the right sign puts its end far away.
        end = (near - down * middles) / (across if abs(across) > 1e-12 else math.copysign(1e-12, across))
        left, right = (left, right.minimum(end)) if across > 0 else (left.maximum(end), right)
    return overlap(strips[:-1], strips[1:], rows).T @ overlap(left, right, columns)


def overlap(start: Tensor, stop: Tensor, edges: Tensor) -> Tensor:
    """Length [S, I] that each interval (`start` to `stop`, [S]) shares with each cell between rising edges [I + 1]."""
    low, high = torch.maximum(start[:, None], edges[:-1]), torch.minimum(stop[:, None], edges[1:])
    return (high - low).clamp(min=0)
