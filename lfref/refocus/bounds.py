"""Pictures bounded by what the views show, where they are in focus.

Filters for all disparities of a scene confuse its light: detail of 1 / e cycles per pixel looks alike at two
disparities that are e apart. Where light is in focus, shifted views agree, and their sum is the picture: a better one
differs from it by a small share of what views differ by, and by what interpolation is uncertain of. Out of focus the
sum is no measure, since it has copies of edges. The views show how far light is from focus: they differ by that
distance times the gradient of their sum.
They are compared in grey; where a grid has an odd number of rows and columns, 5 or more, every other view is.
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
def _compared(aperture: Tensor) -> tuple[int, Tensor, list[float]]:
    """Every how many views are compared, their weights [V, U], and the variances of their offsets in square view steps.

    The outermost views of both axes are among them.
    """
    step = 2 if all(n_views % 2 and n_views >= 5 for n_views in aperture.shape) else 1
    weights = aperture[::step, ::step]
    if step > 1 and float(weights.sum()) == 0:
        step, weights = 1, aperture
    weights = weights / weights.sum()
    v, u = (step * geometry.angular_offsets(n_views) for n_views in weights.shape)
    return step, weights, [float(weights.sum(1) @ v.square()), float(weights.sum(0) @ u.square())]


def _blurs(planes: Tensor, aperture: Tensor) -> list[Tensor]:
    """Blur of linear interpolation down and across, [N, 1, 1, 1], in second derivatives of the picture."""
    blurs = []
    for axis, n_views in enumerate(aperture.shape):
        fraction = planes.double()[:, None] * on_device(geometry.angular_offsets(n_views), planes.device) % 1
        weights = on_device(aperture.sum(1 - axis), planes.device, torch.float64)
        # A view between two samples, at a fraction f of their distance, is off by f (1 - f) / 2 second derivatives.
        blurs.append((fraction * (1 - fraction) / 2 @ weights)[:, None, None, None])
    return blurs


def _bend(images: Tensor, axis: int) -> Tensor:
    """Second differences along an axis; beyond the border pixels repeat."""
    length = images.shape[axis]
    padded = torch.cat([images.narrow(axis, 0, 1), images, images.narrow(axis, length - 1, 1)], axis)
    return padded.narrow(axis, 2, length) - 2 * images + padded.narrow(axis, 0, length)


def _bounds(field: Tensor, planes: Tensor, aperture: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Share of each pixel to which bounds apply, 0 to 1, [N, 1, H, W], and least and largest values, [N, C, H, W]."""
    grid, size = batches.grid_and_size(field)
    points = shift_and_sum(field, planes, "cubic", weights=aperture)
    step, weights, (down, across) = _compared(aperture)
    # Grey views show how they differ; squares of small numbers differ by less rounding.
    grey = field[::step, ::step].mean(2, keepdim=True)
    middle = grey.mean()
    grey = grey - middle
    both = shift_and_sum(torch.cat([grey, grey.square()], 2), step * planes, "linear", weights=weights)
    smooth, squares = both.split(1, 1)
    variance = (squares - smooth.square()).clamp(min=0)
    on_field = on_device(planes, field.device)
    shifts = shifts_of(on_field, grid, CUBIC)
    covered, _ = shifts.coverage(on_device(aperture, field.device), size, BORDERS["renormalize"])
    sharp = points.mean(1, keepdim=True) - middle
    # Views at offset q differ by blur q times the gradient; fewer views lie closer together.
    unit = down * gradient(sharp, -2).square() + across * gradient(sharp, -1).square()
    unit = unit * covered[:, None].to(unit).square()
    measured, unit = (box_mean(maps, WINDOW) for maps in (variance, unit))
    blur = (measured / unit.clamp(min=ALIKE**2)).sqrt()
    share = ((BLURRED - blur) / (BLURRED - IN_FOCUS)).clamp(0, 1)
    by_rows, by_columns = (blur.to(sharp) for blur in _blurs(on_field, aperture))
    uncertain = (by_rows * _bend(sharp, -2) + by_columns * _bend(sharp, -1)).abs()
    # Where some views do not see a pixel, filters read what lies beyond their edges.
    room = (SHARE * variance.sqrt() + INTERPOLATION * uncertain) * (covered[:, None] > 0.999)
    bound = box_max(room, 3)
    return share.to(points), points - bound, points + bound
