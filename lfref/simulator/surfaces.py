"""Positions of surfaces: disparity at points of the central view, and the point where a ray meets a surface.

Letters: `X Y` point of the surface in pixels of the central view, origin at the picture's centre; `p q` aperture point
in view steps from the centre, along columns and rows; `x y` pixel of the picture from that aperture point. `D`
disparity at which a ray meets the surface; `d(X, Y)` disparity of the surface. Since x = X + D p and y = Y + D q, D is
the only unknown of D = d(x - D p, y - D q).
"""

import abc
import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from lfref.simulator import checks

STEEPEST = 0.5
"""Greatest |gradient of d| times half the aperture: below 1, rays meet a surface once; 0.5 leaves Newton a margin."""


class Form(NamedTuple):
    """Parameters of all surfaces: d = disparity + a X + b Y + bulge (1 - r^2 / radius^2)^2 within the radius."""

    disparity: float  # disparity at the centre, without the bump
    a: float = 0.0
    b: float = 0.0
    bulge: float = 0.0
    radius: float = 1.0
    centre_x: float = 0.0  # X of the top of the bump
    centre_y: float = 0.0


class Geometry(checks.Description, abc.ABC):
    """Place of a surface in space."""

    @property
    @abc.abstractmethod
    def form(self) -> Form:
        """The parameters of the surface."""

    @property
    def is_parallel(self) -> bool:
        """Whether it faces the camera: its disparity is the same everywhere, and every view is a shifted copy."""
        return self.form[1:4] == (0, 0, 0)

    def disparity_at(self, x: Tensor, y: Tensor) -> Tensor:
        """Disparity at points (X, Y) of the central view, of the broadcast shape."""
        form = self.form
        offset_x, offset_y = (x - form.centre_x) / form.radius, (y - form.centre_y) / form.radius
        rise = (1 - offset_x**2 - offset_y**2).clamp(min=0)
        return form.disparity + form.a * x + form.b * y + form.bulge * rise**2

    def disparity_range(self, size: tuple[int, int]) -> tuple[float, float]:
        """Least and greatest disparity in a central view of H x W pixels; a bump counts even outside of the picture."""
        return self.ray_disparity_range(((size[1] - 1) / 2, (size[0] - 1) / 2), (0, 0))

    def ray_disparity_range(
        self, half_size: tuple[float, float], half_aperture: tuple[float, float]
    ) -> tuple[float, float]:
        """Least and greatest disparity that rays can meet, for pixels up to (|x|, |y|) and apertures up to (|p|, |q|).

        D of a plane is monotonic in x, y, p and q: its extremes are at corners. The whole height of a bump is added.
        """
        disparity, a, b, bulge = self.form[:4]
        corners = itertools.product(*((-half, half) for half in (*half_size, *half_aperture)))
        values = [(disparity + a * x + b * y) / (1 + a * p + b * q) for x, y, p, q in corners]
        return min(values) + min(bulge, 0), max(values) + max(bulge, 0)

    def steepness(self) -> tuple[float, float]:
        """Greatest change of disparity per pixel along x, and along y; (1 - r^2)^2 is steepest at r = 1 / sqrt 3."""
        form = self.form
        bump = abs(form.bulge) / form.radius * 8 / (3 * math.sqrt(3))
        return abs(form.a) + bump, abs(form.b) + bump


@dataclass(frozen=True)
class Plane(Geometry):
    """A plane: d(X, Y) = disparity + a X + b Y."""

    lengths = ("disparity",)
    disparity: float  # disparity at the centre, in pixels per view step
    gradient: tuple[float, float] = (0.0, 0.0)
    """(a, b): change of disparity per pixel to the right, and per pixel down."""

    @property
    def form(self) -> Form:
        """The parameters of the plane."""
        return Form(self.disparity, *self.gradient)


@dataclass(frozen=True)
class Dome(Geometry):
    """A round bump on a plane that faces the camera: d = disparity + bulge (1 - r^2 / radius^2)^2 within the radius."""

    lengths = ("disparity", "bulge", "radius", "centre")
    disparity: float  # disparity of the plane, in pixels per view step
    bulge: float  # disparity that the top adds, in pixels per view step; below 0 it is a hollow
    radius: checks.Positive  # radius in pixels of the central view
    centre: tuple[float, float] = (0.0, 0.0)  # (X, Y) of the top

    @property
    def form(self) -> Form:
        """The parameters of the dome."""
        return Form(self.disparity, 0.0, 0.0, self.bulge, self.radius, *self.centre)
