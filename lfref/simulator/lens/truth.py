"""The truth: the stack that a lens with the full continuous aperture records.

I_s(x, y) = mean over aperture points (p, q) of the radiance through them at (x + s p, y + s q). Only what hides what is
sampled, cell by cell of the aperture, and within a cell each surface is blurred by the way it moves there. A surface in
focus needs no cells; of one that is seen alone, only shifted, the sum over all cells is a single filter.
Letters: `N` planes, `J I` rows and columns of cells; `s` slope, `d` disparity, others as in `aperture_cells`.
"""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.simulator.lens import alone, aperture_cells, together, together_eager
from lfref.simulator.lens.scenery import FocalPlane, Scenery, visible
from lfref.simulator.painting.layers import Layer, only_shifts
from lfref.simulator.scene import Camera

CELLS_ALONE = 24
"""Cells a side for a surface alone: 58 dB and more against closed forms, for waves of up to 0.3 cycles a pixel."""
LOBE = 1.5
"""Standard deviations that a highlight may move over its surface within a cell."""


def stack(
    layers: Sequence[Layer],
    camera: Camera,
    slopes: geometry.Slopes,
    n_cells: int | None = None,
) -> Tensor:
    """Photograph layers at each slope.

    Args:
        layers: From far to near, painted for a reach of the greatest |slope|.
        camera: The lens and the size of the picture.
        slopes: Of the planes in pixels per view step, [N].
        n_cells: Cells along the aperture's longer side; None takes as many as each plane needs.

    Returns:
        The stack, of the layers' type and device, [N, 3, H, W].

    Raises:
        InputError: Slopes that the picture is too small for, or no cell.
    """
    values = geometry.checked_slopes(slopes, camera.grid, camera.size).tolist()
    if n_cells is not None and n_cells < 1:
        raise InputError("n_cells must be at least 1", got=n_cells)
    all_layers = Scenery(tuple(layers), camera, aperture_cells.aperture(camera)).for_planes(values)
    planes = [_planned(all_layers, slope, n_cells) for slope in values]
    on_cpu = layers[0].device.type == "cpu"
    several = together.camera(planes) if on_cpu else together_eager.photograph
    nothing = layers[0].bitmap.samples.new_zeros(3, *camera.size)
    return torch.stack([_photographed(plane, several) if plane.seen.layers else nothing for plane in planes])


def _planned(scenery: Scenery, slope: float, n_cells: int | None) -> FocalPlane:
    seen = scenery.only(visible(scenery, slope))
    return FocalPlane(slope, seen, aperture_cells.cut(scenery.whole, n_cells or cells_needed(seen, slope)))


def _photographed(plane: FocalPlane, several: Callable[[FocalPlane], Tensor]) -> Tensor:
    is_alone = len(plane.seen.layers) == 1 and not plane.followed
    return alone.photograph(plane) if is_alone else several(plane)


def cells_needed(seen: Scenery, slope: float) -> int:
    """How many cells a side of the aperture a plane needs.

    Besides `aperture_cells.needed`, a highlight may move over its surface by some of its width within a cell. A surface
    that is alone and only shifted gets more: there they make the picture better and cost nothing.

    Args:
        seen: What shows in it.
        slope: Of the plane, in pixels per view step.
    """
    if len(seen.layers) == 1 and only_shifts(seen.layers[0].surface):
        return CELLS_ALONE
    joint = aperture_cells.needed(seen.whole, [_fastest(layer, seen.camera, slope) for layer in seen.layers])
    steps = [seen.whole.extent * _highlight_speed(layer) for layer in seen.layers]
    return max(joint, *(math.ceil(step - 1e-9) for step in steps), 1)


def _fastest(layer: Layer, camera: Camera, slope: float) -> float:
    """Most pixels per view step that anything seen in a layer moves in a plane."""
    ends = [*layer.surface.geometry.disparity_range(camera.size)]
    if layer.reflection and layer.reflection.share > 0:
        ends.append(layer.reflection.disparity)
    return max(abs(end - slope) for end in ends)


def _highlight_speed(layer: Layer) -> float:
    """Of a highlight over its surface, in `LOBE` per view step."""
    return abs(layer.highlight.drift) / (LOBE * layer.highlight.width) if layer.highlight else 0.0
