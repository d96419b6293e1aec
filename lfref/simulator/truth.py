"""The truth: the stack that a lens with the full continuous aperture A photographs.

    I_s(x, y) = mean over (p, q) in A of the radiance through (p, q) at (x + s p, y + s q)

The integral needs sampling only because surfaces hide parts of each other. Steps for each plane:
1. Choose the visible layers and the number of cells of the aperture (`focal_planes`).
2. A single layer that is only shifted needs no sampling: the sum over all cells is a linear filter, computed here.
3. Otherwise blur every layer by its motion within a cell, composite through the middle of every cell, and take the
   weighted mean (`truth_cells`, with compiled loops in `truth_loops`).
Letters: `N` planes, `s` slope, `J I` rows and columns of cells, others as in `focal_planes`.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.simulator import focal_planes, truth_loops
from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.focal_planes import FocalPlane
from lfref.simulator.layers import Layer
from lfref.simulator.scene import Camera
from lfref.simulator.truth_cells import CellRenderer, render_eagerly


def stack(layers: Sequence[Layer], camera: Camera, slopes: geometry.Slopes, n_cells: int | None = None) -> Tensor:
    """Photograph layers at each slope.

    Args:
        layers: From far to near, painted for a reach of the greatest |slope|.
        camera: The lens and the size of the picture.
        slopes: Of the planes in pixels per view step, [N].
        n_cells: Cells along the aperture's longer side; None takes as many as each plane needs.

    Returns:
        The stack, of the layers' type and device, [N, 3, H, W].

    Raises:
        InputError: Slopes that are too large for the picture, or no cell.
    """
    values = geometry.checked_slopes(slopes, camera.grid, camera.size).tolist()
    if n_cells is not None and n_cells < 1:
        raise InputError("n_cells must be at least 1", got=n_cells)
    planes = focal_planes.focal_planes(layers, camera, values, n_cells)
    on_cpu = layers[0].device.type == "cpu"
    render = CellRenderer(planes).render if on_cpu else render_eagerly
    pictures = []
    for plane in planes:
        if not plane.layers:
            pictures.append(layers[0].bitmap.samples.new_zeros(3, *camera.size))
        elif len(plane.layers) == 1 and not plane.traced:
            pictures.append(filter_layer(plane))
        else:
            pictures.append(render(plane))
    return torch.stack(pictures)


def filter_layer(plane: FocalPlane) -> Tensor:
    """The picture of a single layer that is only shifted, by a few separable filters, [3, H, W].

    The weighted sum over all cells separates into rows and columns for rows of cells that are open alike: all rows of a
    square, pairs of rows of a disc. Each such group is one filter along columns and one along rows.
    """
    (layer,) = plane.layers
    samples = plane.window(layer.bitmap)[:3]
    picture = samples.new_zeros(3, *plane.camera.size)
    cell = plane.filter(layer.surface.geometry.form.disparity)
    shares, groups = np.unique(plane.cells.weights.numpy().round(12), axis=0, return_inverse=True)
    for group, share in enumerate(shares):
        if not share.any():
            continue
        in_group = (groups.reshape(-1) == group).astype(float)
        top, down = focal_planes.combined_taps(cell.down, cell.rows, in_group)
        left, across = focal_planes.combined_taps(cell.across, cell.columns, share)
        if samples.device.type == "cpu":
            truth_loops.filter_at_pixels(samples.numpy(), down, across, top, left, OVERSAMPLING, picture.numpy())
        else:
            rows = _filter_matrix(top, down, picture.shape[1], samples.shape[1]).to(samples)
            columns = _filter_matrix(left, across, picture.shape[2], samples.shape[2]).to(samples)
            picture += rows @ samples @ columns.mT
    return picture


def _filter_matrix(first: int, taps: NDArray, length: int, n_samples: int) -> Tensor:
    """A filter at every pixel as a matrix, float64, [length, n_samples]."""
    matrix = torch.zeros(length, n_samples, dtype=torch.float64)
    pixels = torch.arange(length)[:, None]
    matrix[pixels, first + OVERSAMPLING * pixels + torch.arange(len(taps))] = torch.from_numpy(taps)
    return matrix
