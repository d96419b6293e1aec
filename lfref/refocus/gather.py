"""Means over the aperture of views that are read wherever a plane lies in them, for surfaces and homographies.

A pixel (x, y) of the picture is read at matrix (x, y, 1), then moved by slope times the view's offset. PyTorch gathers
samples by index, so that everything is differentiable twice, forwards too, also in the positions.
Letters: `v u` view row and column, `y x w` homogeneous pixel of the picture.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import chosen
from lfref.refocus import batches
from lfref.refocus.sampling import BORDERS, FARTHEST, INTERPOLATIONS, ON_VIEW, Border, Interpolation


class ViewMap(NamedTuple):
    """Positions in each view of what is at the pixels of one plane."""

    matrices: Tensor | None = None
    """From pixels of the picture to those of each view, float64, [V, U, 3, 3]; None: the same pixel."""
    slopes: Tensor | None = None
    """At each pixel, in pixels per view step, float64, [H, W]; None: 0."""
    positions: Tensor | None = None
    """(v, u) of each view from the middle of the grid, in view steps, float64, CPU, [V, U, 2]; None: an even grid."""


def mean_of_views(
    views: Tensor, aperture: Tensor, planes: Sequence[ViewMap], interpolation: str, border: str
) -> Tensor:
    """Weighted mean, at each pixel, of the views [B, V, U, C, H, W] that have a sample there; 0 where none has."""
    local = {name: record for name, record in INTERPOLATIONS.items() if record.weights is not None}
    method = chosen("interpolation at positions that vary over the picture", interpolation, local)
    rule = chosen("border", border, BORDERS)
    n_rows, n_columns, height, width = *aperture.shape, *views.shape[-2:]
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in (height, width))
    images = []
    for plane in planes:
        image = torch.zeros_like(batches.radiance(views[:, 0, 0]))
        coverage = torch.zeros(height, width, dtype=torch.float64, device=views.device)
        offsets = (batches.even((n_rows, n_columns)) if plane.positions is None else plane.positions).tolist()
        for v, u in aperture.nonzero().tolist():
            x, y, visible = columns[None], rows[:, None], torch.ones_like(coverage, dtype=torch.bool)
            if plane.matrices is not None:
                x, y, w = (row[0] * x + row[1] * y + row[2] for row in plane.matrices[v, u])
                visible = w > 0
                # Divided by 1 instead of 0 behind the camera: those are left out, but NaN would reach the gradients.
                w = torch.where(visible, w, 1.0)
                x, y = x / w, y / w
            if plane.slopes is not None:
                x, y = x + plane.slopes * offsets[v][u][1], y + plane.slopes * offsets[v][u][0]
            samples, has_sample = sample(batches.radiance(views[:, v, u]), x, y, method, rule)
            counted, weight = has_sample & visible, float(aperture[v, u])
            image = image + torch.where(counted, samples, 0.0) * weight
            coverage = coverage + counted.to(coverage) * weight
        images.append(image * torch.where(coverage > 0, 1 / coverage, 0.0).to(image))
    return torch.stack(images, dim=1)


def sample(images: Tensor, x: Tensor, y: Tensor, method: Interpolation, border: Border) -> tuple[Tensor, Tensor]:
    """Read images [..., H, W] at any positions in pixels, float64, that broadcast to [P...].

    Returns samples [..., P...], and where there are some, [P...]: on the image if only samples count, else everywhere.
    """
    assert method.weights is not None, "this interpolation reads all samples"
    taps, has_sample = [], torch.ones_like(x, dtype=torch.bool)
    for exact, length in zip((y, x), images.shape[-2:], strict=True):
        position = (exact + 0.5).floor() if method.rounds else exact
        within = position.clamp(-FARTHEST, FARTHEST)
        whole = within.detach().floor()
        weights = enumerate(method.weights(within - whole))
        taps.append([border.tap(whole.long() - method.before + i, weight, length) for i, weight in weights])
        if border.counts_only_samples:
            has_sample = has_sample & (position >= -ON_VIEW) & (position <= length - 1 + ON_VIEW)
    flat, width = images.flatten(-2), images.shape[-1]
    total = torch.zeros((), dtype=images.dtype, device=images.device)
    for row, row_weight in taps[0]:
        for column, column_weight in taps[1]:
            weight, index = (row_weight * column_weight).to(images), row * width + column
            # Far faster than `flat[..., index]`.
            samples = flat.gather(-1, index.reshape(-1).expand(*flat.shape[:-1], -1))
            total = total + samples.reshape(*flat.shape[:-1], *index.shape) * weight
    return total, has_sample
