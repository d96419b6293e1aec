"""The truth: the stack that a lens with the full continuous aperture records.

I_s(x, y) = mean over aperture points (p, q) of the radiance through them at (x + s p, y + s q). Only what hides what is
sampled, cell by cell of the aperture, and within a cell each surface is blurred by the way it moves there: a surface
in focus needs no cells, and one that nothing covers has a closed form.
Letters: `N` planes, `J I` rows and columns of cells; `s` slope, `d` disparity, others as in `aperture_cells`.
"""

import itertools
import math
from collections.abc import Sequence

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.simulator import aperture_cells, render, truth_parallel
from lfref.simulator.aperture_cells import Aperture
from lfref.simulator.bitmaps import Layer
from lfref.simulator.materials import Glass, Glossy, Mirror
from lfref.simulator.scene import Camera

CELLS_AT_ONCE = 16
"""More take memory and no less time."""


def stack(
    layers: Sequence[Layer],
    camera: Camera,
    slopes: geometry.Slopes,
    opening: float = 1.0,
    n_cells: int | None = None,
) -> Tensor:
    """Photograph layers at each slope.

    Args:
        layers: From far to near, painted for a reach of the greatest |slope|.
        camera: The lens and the size of the picture.
        slopes: Of the planes in pixels per view step, [N].
        opening: Part of the aperture's width and height that is open, 0 to 1; 0 is the central view.
        n_cells: Cells along the aperture's longer side; None takes as many as each plane needs, and closed forms.

    Returns:
        The stack, float32 (float64 for such layers), [N, 3, H, W].

    Raises:
        InputError: Slopes that the picture is too small for, an opening outside [0, 1], or no cell.
    """
    values = geometry.checked_slopes(slopes, camera.grid, camera.size).tolist()
    if not 0 <= opening <= 1:
        raise InputError("opening must lie between 0 and 1", got=opening)
    if n_cells is not None and n_cells < 1:
        raise InputError("n_cells must be at least 1", got=n_cells)
    whole = aperture_cells.aperture(camera, opening)
    if not all(map(truth_parallel.can_serve, layers)):
        return torch.stack([_through_cells(layers, camera, whole, slope, n_cells) for slope in values])
    pictures = truth_parallel.sampled(layers, camera, whole, values)
    return torch.stack([truth_parallel.plane(pictures, slope, n_cells) for slope in values])


def _through_cells(
    layers: Sequence[Layer], camera: Camera, whole: Aperture, slope: float, n_cells: int | None
) -> Tensor:
    """One plane of any layers, [3, H, W]."""
    cells = aperture_cells.cut(whole, n_cells or cells_needed(layers, camera, whole, slope))
    widths = {layer: _speeds(layer, camera, slope)[0] * (cells.height + cells.width) / 2 for layer in layers}
    q, p = (points.flatten() for points in torch.meshgrid(cells.q, cells.p, indexing="ij"))
    is_open = cells.weights.flatten() > 0
    x, y = camera.pixels()
    picture = torch.zeros(())
    for part in torch.stack([p, q, cells.weights.flatten()])[:, is_open].split(CELLS_AT_ONCE, dim=1):
        p, q, weights = part
        places = x + slope * p[:, None, None], y + slope * q[:, None, None]
        seen = render.radiance(layers, p, q, *places, widths.__getitem__)
        picture = torch.einsum("m,mchw->chw", weights.to(seen), seen) + picture.to(seen)
    return picture


def cells_needed(layers: Sequence[Layer], camera: Camera, whole: Aperture, slope: float) -> int:
    """How many cells a side of the aperture a plane of any layers needs.

    Besides `aperture_cells.needed`, within a cell the ways of a surface's parts, which share one blur, may differ by a
    pixel, the line where surfaces cross may move by one, and a highlight by half its width.

    Args:
        layers: From far to near.
        camera: The lens and the size of the picture.
        whole: The aperture, as far as it is open.
        slope: Of the plane, in pixels per view step.
    """
    shown = layers if render.may_cross(layers) else render.visible(layers)
    ways = [_speeds(layer, camera, slope) for layer in shown]
    steps = [
        *(whole.extent * (fastest - slowest) for slowest, fastest in ways),
        *(whole.extent * max(ways[k][1] for k in pair) for pair in _crossing(shown, camera)),
        *(whole.extent * _highlight_speed(layer) for layer in shown),
    ]
    joint = aperture_cells.needed(whole, [fastest for _, fastest in ways])
    return max(joint, *(math.ceil(step - 1e-9) for step in steps))


def _crossing(layers: Sequence[Layer], camera: Camera) -> list[tuple[int, int]]:
    """Pairs of layers that may cross: there a hard edge moves, which no blur of layers softens."""
    ranges = [layer.disparities(camera.size) for layer in layers]
    pairs = itertools.combinations(range(len(ranges)), 2)
    return [(k, m) for k, m in pairs if max(ranges[k][0], ranges[m][0]) < min(ranges[k][1], ranges[m][1])]


def _speeds(layer: Layer, camera: Camera, slope: float) -> tuple[float, float]:
    """Least and most pixels per view step that anything seen in a layer moves in a plane."""
    material = layer.surface.material
    low, high = layer.disparities(camera.size)
    if isinstance(material, Mirror | Glass):
        low, high = min(low, material.disparity), max(high, material.disparity)
    ends = abs(low - slope), abs(high - slope)
    return 0.0 if low <= slope <= high else min(ends), max(ends)


def _highlight_speed(layer: Layer) -> float:
    """Of a highlight over its surface, in half widths per view step."""
    material = layer.surface.material
    return 2 * abs(material.drift) / material.width if isinstance(material, Glossy) else 0.0
