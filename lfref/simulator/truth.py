"""The plane of a layer that is seen alone and only shifted: the sum over all cells is one filter, or a few.

Rows of cells that are open alike share a filter along rows: all of a square, two by two those of a disc.
Letters: as in `cell_blur`.
"""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.simulator import scenery, truth_loops, truth_together
from lfref.simulator import scenery as aperture_cells
from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.layers import Layer, only_shifts
from lfref.simulator.scene import Camera
from lfref.simulator.scenery import FocalPlane, Scenery, visible

Taps = tuple[int, NDArray]
"""Sample that the first tap reads for pixel 0, and the taps."""


def photograph(plane: FocalPlane) -> Tensor:
    """The picture of one layer that is not followed, [3, H, W]."""
    (layer,) = plane.seen.layers
    samples = plane.seen.window(layer.bitmap, plane.slope)[:3]
    picture = samples.new_zeros(3, *plane.seen.camera.size)
    add = _add_compiled if samples.device.type == "cpu" else _add_eager
    for down, across in _filters(plane, plane.slope - layer.surface.geometry.form.disparity):
        add(samples, down, across, picture)
    return picture


def _filters(plane: FocalPlane, e: float) -> Iterator[tuple[Taps, Taps]]:
    """Pairs of filters along columns and rows, whose sum the plane is."""
    one = scenery.cell_filter(e, plane.cells, plane.seen.margin_at(plane.slope))
    shares, groups = np.unique(plane.cells.weights.numpy().round(12), axis=0, return_inverse=True)
    for group, share in enumerate(shares):
        if share.any():
            down = scenery.summed(one.down, one.rows, (groups.reshape(-1) == group).astype(float))
            yield down, scenery.summed(one.across, one.columns, share)


def _add_compiled(samples: Tensor, down: Taps, across: Taps, picture: Tensor) -> None:
    truth_loops.pick(samples.numpy(), down[1], across[1], down[0], across[0], OVERSAMPLING, picture.numpy())


def _add_eager(samples: Tensor, down: Taps, across: Taps, picture: Tensor) -> None:
    rows, columns = (
        _band(*taps, length, n_samples).to(samples)
        for taps, length, n_samples in zip((down, across), picture.shape[1:], samples.shape[1:], strict=True)
    )
    picture += rows @ samples @ columns.mT


def _band(first: int, taps: NDArray, length: int, n_samples: int) -> Tensor:
    """A filter at every pixel as a matrix, float64, [length, n_samples]."""
    matrix = torch.zeros(length, n_samples, dtype=torch.float64)
    pixels = torch.arange(length)[:, None]
    matrix[pixels, first + OVERSAMPLING * pixels + torch.arange(len(taps))] = torch.from_numpy(taps)
    return matrix


# PART truth
# The truth: the stack that a lens with the full continuous aperture records.
#
# I_s(x, y) = mean over aperture points (p, q) of the radiance through them at (x + s p, y + s q). Only what hides
# what is
# sampled, cell by cell of the aperture, and within a cell each surface is blurred by the way it moves there. A
# surface in
# focus needs no cells; of one that is seen alone, only shifted, the sum over all cells is a single filter.
# Letters: `N` planes, `J I` rows and columns of cells; `s` slope, `d` disparity, others as in `aperture_cells`.

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
    several = truth_together.camera(planes) if on_cpu else truth_together.photograph
    nothing = layers[0].bitmap.samples.new_zeros(3, *camera.size)
    return torch.stack([_photographed(plane, several) if plane.seen.layers else nothing for plane in planes])


def _planned(scenery: Scenery, slope: float, n_cells: int | None) -> FocalPlane:
    seen = scenery.only(visible(scenery, slope))
    return FocalPlane(slope, seen, aperture_cells.cut(scenery.whole, n_cells or cells_needed(seen, slope)))


def _photographed(plane: FocalPlane, several: Callable[[FocalPlane], Tensor]) -> Tensor:
    is_alone = len(plane.seen.layers) == 1 and not plane.followed
    return photograph(plane) if is_alone else several(plane)


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
