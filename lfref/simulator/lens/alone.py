"""The plane of a layer that is seen alone and only shifted: the sum over all cells is one filter, or a few.

Rows of cells that are open alike share a filter along rows: all of a square, two by two those of a disc.
Letters: as in `cell_blur`.
"""

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.lens import cell_blur, smooth_loop
from lfref.simulator.lens.scenery import FocalPlane

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
    one = cell_blur.cell_filter(e, plane.cells, plane.seen.margin_at(plane.slope))
    shares, groups = np.unique(plane.cells.weights.numpy().round(12), axis=0, return_inverse=True)
    for group, share in enumerate(shares):
        if share.any():
            down = cell_blur.summed(one.down, one.rows, (groups.reshape(-1) == group).astype(float))
            yield down, cell_blur.summed(one.across, one.columns, share)


def _add_compiled(samples: Tensor, down: Taps, across: Taps, picture: Tensor) -> None:
    smooth_loop.pick(samples.numpy(), down[1], across[1], down[0], across[0], OVERSAMPLING, picture.numpy())


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
