"""Pictures bounded by what the views show, where filters for all disparities of a scene confuse its light.

Letters: `N` planes, `C H W` channel, pixel row and column, `V U` view rows and columns.
"""

import torch
from torch import Tensor

from lfref.functional.devices import on_device
from lfref.functional.neighbours import box_max
from lfref.refocus import batches
from lfref.refocus.sampling import BORDERS, CUBIC
from lfref.refocus.scene import Scene
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shifts import shifts_of

CONFUSABLE = 2.5
"""Range of disparities in pixels per view step from which layers confuse light at two disparities, e apart: detail of
1 / e cycles per pixel, in a row or a column, looks alike at both, and pictures end at about .4 cycles per pixel."""
RANGES, SHARES_OF_SPREAD = (5.0, 7.0), (0.15, 0.025)
"""Where layers are confused: the largest difference of a picture from the sum of its views, in standard deviations of
the views, at two ranges of disparities; between them in proportion. By trial, on the scenes `deep` and `apple` of
sim30, and `sim30.WIDE`."""


def confuses(scene: Scene) -> bool:
    """Whether most of a scene's disparities are so far apart that layers confuse its light."""
    return scene.known is not None and scene.known.common[1] - scene.known.common[0] > CONFUSABLE


def bounded_by_views(stack: Tensor, scene: Scene, planes: Tensor, aperture: Tensor) -> Tensor:
    """A stack [N, C, H, W]; where light is confused, no farther from the sum of the views than views differ.

    Planes beyond the disparities of the scene stay as they are: all is blurred there, and the sum, which has copies of
    edges, is no measure. So do pixels that some view does not see.
    """
    if scene.known is None:
        return stack
    near = ((planes >= scene.known.low) & (planes <= scene.known.high)).nonzero()[:, 0]
    if not len(near):
        return stack
    reach = scene.ends_of_energies[1] - scene.ends_of_energies[0]
    (narrow, wide), (most, least) = RANGES, SHARES_OF_SPREAD
    share = most + ((reach - narrow) / (wide - narrow)).clamp(0, 1) * (least - most)
    field, slopes = scene.light, planes[near]
    grid, size = batches.grid_and_size(field)
    with torch.no_grad():
        points = shift_and_sum(field, slopes, "cubic", weights=aperture)
        squares = shift_and_sum(field.square(), slopes, "cubic", weights=aperture)
        spread = (squares - points.square()).clamp(min=0).sqrt().amax(1, keepdim=True)
        shifts = shifts_of(on_device(slopes, field.device), grid, CUBIC)
        covered, _ = shifts.coverage(on_device(aperture, field.device), size, BORDERS["renormalize"])
        is_bounded = (covered[:, None] > 0.999) & (reach > CONFUSABLE)  # 1, but for rounding
        bound = torch.where(is_bounded, share.to(spread) * box_max(spread, 3), torch.inf)
    at = on_device(near, stack.device)
    inside = torch.maximum(torch.minimum(stack[at], points + bound), points - bound)
    return stack.index_copy(0, at, inside)
