"""How far rays go: what a camera can reach of a surface, and what stands before what there.

Two surfaces that keep their order over all of the central view keep it along every ray: where a ray meets the farther
one, it is behind the nearer one already. Letters: `X Y` as in `surfaces`.
"""

import itertools
from collections.abc import Sequence

from lfref.simulator.scene import Camera
from lfref.simulator.surfaces import Geometry

SLACK = 3.0
"""Pixels beyond what rays can reach, for the outer samples of look-ups and for lateral effects."""

Ends = tuple[float, float]
"""Greatest |X| and |Y| in pixels."""


def span(camera: Camera, geometry: Geometry, reach: float) -> tuple[float, float]:
    """Least and greatest disparity that rays may meet of a surface; arguments as for `ends`."""
    return geometry.met_range(_half_size(camera, reach), camera.half_aperture)


def ends(camera: Camera, geometry: Geometry, reach: float) -> Ends:
    """How far from the centre rays meet a surface.

    Args:
        camera: Where they start.
        geometry: The surface.
        reach: Greatest |slope| of the pictures asked for, in pixels per view step.
    """
    half_width, half_height = _half_size(camera, reach)
    half_p, half_q = camera.half_aperture
    farthest = max(map(abs, span(camera, geometry, reach)))
    return half_width + farthest * half_p + SLACK, half_height + farthest * half_q + SLACK


def _half_size(camera: Camera, reach: float) -> Ends:
    """Half the width and height of all that pictures refocused look at."""
    half_p, half_q = camera.half_aperture
    return (camera.size[1] - 1) / 2 + reach * half_p, (camera.size[0] - 1) / 2 + reach * half_q


def lead(near: Geometry, far: Geometry, within: Ends) -> tuple[float, float]:
    """Least and greatest disparity that one surface has more than another.

    Args:
        near: The one.
        far: The other.
        within: Where they are compared.
    """
    one, other = near.form, far.form
    middle = one.disparity - other.disparity
    spread = abs(one.a - other.a) * within[0] + abs(one.b - other.b) * within[1]
    lowest = min(one.bulge, 0) - max(other.bulge, 0)
    highest = max(one.bulge, 0) - min(other.bulge, 0)
    return middle - spread + lowest, middle + spread + highest


def crossing(surfaces: Sequence[Geometry], camera: Camera, reach: float) -> list[tuple[int, int]]:
    """Pairs of surfaces of which each may be before the other.

    Args:
        surfaces: Some surfaces.
        camera: What looks at them.
        reach: Greatest |slope| of the pictures asked for.

    Returns:
        Their places, the smaller first.
    """
    far = [ends(camera, surface, reach) for surface in surfaces]
    leads = {
        (k, m): lead(surfaces[m], surfaces[k], _both(far[k], far[m]))
        for k, m in itertools.combinations(range(len(surfaces)), 2)
    }
    return [pair for pair, (least, greatest) in leads.items() if least < 0 < greatest]


def is_before(near: Geometry, far: Geometry, camera: Camera, reach: float) -> bool:
    """Whether one surface is nowhere behind another; arguments as above."""
    within = _both(ends(camera, near, reach), ends(camera, far, reach))
    return lead(near, far, within)[0] >= 0


def _both(one: Ends, other: Ends) -> Ends:
    return max(one[0], other[0]), max(one[1], other[1])
