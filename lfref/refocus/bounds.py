"""Pictures bounded by what the views show, where they are in focus.

Filters for all disparities of a scene confuse its light: detail of 1 / e cycles per pixel looks alike at two
disparities that are e apart. Where light is in focus, shifted views agree, and their sum is the picture: a better one
differs from it by a small share of what views differ by, and by what interpolation is uncertain of. Out of focus the
sum is no measure, since it has copies of edges. The views show how far light is from focus: they differ by that
distance times the gradient of their sum.
They are compared in grey.
Letters: `N` planes, `C H W` channel, pixel row and column, `V U` view rows and columns.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional.devices import is_known, on_device, on_host
from lfref.functional.neighbours import box_max, box_mean, gradient
from lfref.refocus import batches
from lfref.refocus.sampling import BORDERS, CUBIC
from lfref.refocus.scene import Scene
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import antialiased
from lfref.refocus.shift.shifts import shifts_of

IN_FOCUS, BLURRED = 1.0, 1.5
"""Distance of light from focus, in pixels per view step, up to which a sum is the picture, and from which it is no
measure: copies that are nearer than one pixel do not show."""
WINDOW = 7
"""Side of the square in pixels in which that distance is measured."""
ALIKE = 1e-3
"""Standard deviation up to which views agree wherever they are flat: a quarter of a level of 8 bits."""
SHARE, INTERPOLATION = 0.02, 3.0
"""Largest difference from the sum: in standard deviations of the views, and in differences of cubic and linear
interpolation. By trial on path-traced scenes, both versions of sim30, and `sim30.WIDE`."""


def bounded_by_views(stack: Tensor, scene: Scene, planes: Tensor, aperture: Tensor) -> Tensor:
    """A stack [N, C, H, W]; where light is in focus, near the sum of the views that see the pixel.

    Where repeated texture leaves open how far light is from focus, the sum of `shift_and_sum_antialiased`.
    """
    if scene.known is not None and scene.known.is_ambiguous:
        return antialiased(scene.light, scene, planes, aperture)
    low, high = scene.ends_of_energies
    slopes = on_device(planes, low.device)
    is_near = (slopes > low - BLURRED) & (slopes < high + BLURRED)
    if not is_known(low):
        return _bounded(stack, scene, planes, aperture, is_near)
    # The host leaves planes out that have no bounds.
    near = is_near.nonzero()[:, 0]
    if not len(near):
        return stack
    return stack.index_copy(0, near, _bounded(stack[near], scene, planes[near], aperture, is_near[near]))


def _bounded(stack: Tensor, scene: Scene, planes: Tensor, aperture: Tensor, is_near: Tensor) -> Tensor:
    with torch.no_grad():
        share, least, most = _bounds(scene.light, planes, aperture)
    share = share * is_near[:, None, None, None]
    return torch.lerp(stack, torch.maximum(torch.minimum(stack, most), least), share)


@on_host
def _spreads(aperture: Tensor) -> tuple[float, float]:
    """Variances of the views' offsets along both axes, in square view steps, by their weights [V, U]."""
    v, u = (geometry.angular_offsets(n_views) for n_views in aperture.shape)
    return float(aperture.sum(1) @ v.square()), float(aperture.sum(0) @ u.square())


def _bounds(field: Tensor, planes: Tensor, aperture: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Share of each pixel to which bounds apply, 0 to 1, [N, 1, H, W], and least and largest values, [N, C, H, W]."""
    grid, size = batches.grid_and_size(field)
    points = shift_and_sum(field, planes, "cubic", weights=aperture)
    # Grey views show how they differ; squares of small numbers differ by less rounding.
    grey = field.mean(2, keepdim=True)
    middle = grey.mean()
    grey = grey - middle
    both = shift_and_sum(torch.cat([grey, grey.square()], 2), planes, "linear", weights=aperture)
    smooth, squares = both.split(1, 1)
    variance = (squares - smooth.square()).clamp(min=0)
    shifts = shifts_of(on_device(planes, field.device), grid, CUBIC)
    covered, _ = shifts.coverage(on_device(aperture, field.device), size, BORDERS["renormalize"])
    sharp = points.mean(1, keepdim=True) - middle
    down, across = _spreads(aperture)
    # Views at offset q differ by blur q times the gradient; fewer views lie closer together.
    unit = down * gradient(sharp, -2).square() + across * gradient(sharp, -1).square()
    unit = unit * covered[:, None].to(unit).square()
    measured, unit = (box_mean(maps, WINDOW) for maps in (variance, unit))
    blur = (measured / unit.clamp(min=ALIKE**2)).sqrt()
    share = ((BLURRED - blur) / (BLURRED - IN_FOCUS)).clamp(0, 1)
    # Where some views do not see a pixel, filters read what lies beyond their edges.
    room = (SHARE * variance.sqrt() + INTERPOLATION * (sharp - smooth).abs()) * (covered[:, None] > 0.999)
    bound = box_max(room, 3)
    return share.to(points), points - bound, points + bound
