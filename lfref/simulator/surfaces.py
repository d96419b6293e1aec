"""Where surfaces stand: disparity as a function of the central view, and where a ray meets it.

Letters: `X Y` point of the surface in pixels of the central view, origin at the picture's centre; `p q` aperture point
in view steps from the centre, along columns and rows; `x y` pixel of the picture seen from there. `D` disparity.
x = X + D(X, Y) p and y = Y + D(X, Y) q, so that D alone is unknown: D = d(x - D p, y - D q).
"""

import abc
import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.simulator import checks

STEEPEST = 0.5
"""Most that the disparity's slope times the aperture's half width may be: a surface is then met once by every ray."""
NEWTON_STEPS = 12
CONVERGED = 1e-8
"""Pixels per view step that a disparity found by Newton's method may still change by."""


class Form(NamedTuple):
    """What surfaces have in common: d = disparity + a X + b Y + bulge (1 - r^2/radius^2)^2 within the radius."""

    disparity: float
    """At the centre, without the bump."""
    a: float = 0.0
    b: float = 0.0
    bulge: float = 0.0
    radius: float = 1.0
    centre_x: float = 0.0
    """X of the bump's top."""
    centre_y: float = 0.0


class Geometry(abc.ABC):
    """A surface's place in space."""

    @property
    @abc.abstractmethod
    def form(self) -> Form:
        """Its numbers."""

    @property
    def is_parallel(self) -> bool:
        """It faces the camera, the same disparity everywhere: every view is a shifted copy."""
        return self.form[1:4] == (0, 0, 0)

    def disparity_at(self, x: Tensor, y: Tensor) -> Tensor:
        """Disparity in pixels per view step at points of the central view.

        Args:
            x: Columns from the centre, in pixels.
            y: Rows from the centre, in pixels, of a shape that goes with x.
        """
        form = self.form
        plane = form.disparity + form.a * x + form.b * y
        return plane + form.bulge * self._rise(x, y)[2] ** 2 if form.bulge else plane

    def gradient_at(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Change of disparity a pixel of X and of Y at points of the central view; arguments as for `disparity_at`."""
        form, (off_x, off_y, rise) = self.form, self._rise(x, y)
        steep = -4 * form.bulge / form.radius * rise
        return form.a + steep * off_x, form.b + steep * off_y

    def _rise(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Offsets from the bump's top in radii, and the root of its share that is reached there."""
        form = self.form
        off_x, off_y = (x - form.centre_x) / form.radius, (y - form.centre_y) / form.radius
        return off_x, off_y, (1 - off_x**2 - off_y**2).clamp(min=0)

    def met_at(self, x: Tensor, y: Tensor, p: Tensor, q: Tensor) -> Tensor:
        """Disparity of what is seen at a pixel from an aperture point: of a plane in closed form, else by Newton.

        Args:
            x: Columns from the centre, in pixels.
            y: Rows from the centre, in pixels.
            p: Columns of the aperture point, in view steps.
            q: Rows of the aperture point, in view steps. All four of shapes that go together.
        """
        form, disparity = self.form, self.disparity_at(x, y)
        if not form.bulge:
            return disparity / (1 + form.a * p + form.b * q)
        disparity = disparity + torch.zeros_like(p + q)
        for _ in range(NEWTON_STEPS):
            at_x, at_y = x - disparity * p, y - disparity * q
            across, down = self.gradient_at(at_x, at_y)
            step = (disparity - self.disparity_at(at_x, at_y)) / (1 + across * p + down * q)
            disparity = disparity - step
            if float(step.abs().max()) < CONVERGED:
                break
        return disparity

    def disparity_range(self, size: tuple[int, int]) -> tuple[float, float]:
        """Least and greatest disparity over the central view; of a bump all, even where the view shows less of it.

        Args:
            size: Its height and width in pixels.
        """
        return self.met_range(((size[1] - 1) / 2, (size[0] - 1) / 2), (0, 0))

    def met_range(self, half_size: tuple[float, float], half_aperture: tuple[float, float]) -> tuple[float, float]:
        """Least and greatest disparity that any ray to a picture may meet: of a plane in corners, and all of a bump.

        Args:
            half_size: Greatest |x| and |y| of its pixels.
            half_aperture: Greatest |p| and |q| of the aperture points.
        """
        disparity, a, b, bulge = self.form[:4]
        corners = itertools.product(*((-half, half) for half in (*half_size, *half_aperture)))
        met = [(disparity + a * x + b * y) / (1 + a * p + b * q) for x, y, p, q in corners]
        return min(met) + min(bulge, 0), max(met) + max(bulge, 0)

    def steepness(self) -> tuple[float, float]:
        """Greatest change of disparity along a pixel of x, and of y; (1 - r^2)^2 is steepest at r = 1 / sqrt 3."""
        form = self.form
        bump = abs(form.bulge) / form.radius * 8 / (3 * math.sqrt(3))
        return abs(form.a) + bump, abs(form.b) + bump


@dataclass(frozen=True)
class Plane(Geometry):
    """A plane: d(X, Y) = disparity + a X + b Y."""

    disparity: float
    """At the centre, in pixels per view step."""
    gradient: tuple[float, float] = (0.0, 0.0)
    """(a, b): change of disparity a pixel to the right, and down."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.numbers("a plane's disparity", [self.disparity])
        checks.pair("a plane's gradient", self.gradient)

    @property
    def form(self) -> Form:
        """As in `Geometry`."""
        return Form(self.disparity, *self.gradient)


@dataclass(frozen=True)
class Dome(Geometry):
    """A round bump on a plane that faces the camera: d = disparity + bulge (1 - r^2/radius^2)^2 within the radius."""

    disparity: float
    """Of the plane, in pixels per view step."""
    bulge: float
    """What the top has more, in pixels per view step; below 0 it is a hollow."""
    radius: float
    """In pixels of the central view."""
    centre: tuple[float, float] = (0.0, 0.0)
    """(X, Y) of the top."""

    def __post_init__(self) -> None:
        checks.freeze(self)
        checks.numbers("a dome's disparity and bulge", [self.disparity, self.bulge])
        checks.above_zero("a dome's radius", self.radius)
        checks.pair("a dome's centre", self.centre)

    @property
    def form(self) -> Form:
        """As in `Geometry`."""
        return Form(self.disparity, 0.0, 0.0, self.bulge, self.radius, *self.centre)
