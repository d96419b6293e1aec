"""Means of views read at any position, by plain PyTorch operations: on any device, and differentiable.

Letters: `u v` view column and row, `x y` pixel column and row.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from lfref.refocus import batches
from lfref.refocus.anywhere.places import Places, pixels
from lfref.refocus.anywhere.sampling import sample
from lfref.refocus.borders import Border
from lfref.refocus.interpolations import Interpolation


def means(
    views: Tensor, aperture: Tensor, planes: Sequence[Places], way: Interpolation, border: Border
) -> tuple[Tensor, Tensor]:
    """Means and coverages of all planes; as `mean_of_views`, but for names."""
    images, coverages = zip(*(_mean(views, aperture, places, way, border) for places in planes), strict=True)
    return torch.stack(images, dim=1), torch.stack(coverages)


def _mean(views: Tensor, aperture: Tensor, places: Places, way: Interpolation, border: Border) -> tuple[Tensor, Tensor]:
    """One plane, [B, C, H, W], and its coverage, [H, W]."""
    image = torch.zeros_like(batches.radiance(views[:, 0, 0]))
    coverage = torch.zeros(views.shape[-2:], dtype=torch.float64, device=views.device)
    offsets = places.offsets((aperture.shape[0], aperture.shape[1])).tolist()
    for v, u in aperture.nonzero().tolist():
        x, y, visible = places.seen_from(v, u, offsets[v][u], *pixels(views))
        samples, has_sample = sample(batches.radiance(views[:, v, u]), x, y, way, border)
        counted, weight = has_sample & visible, float(aperture[v, u])
        image = image + torch.where(counted, samples, 0.0) * weight
        coverage = coverage + counted.to(coverage) * weight
    return image * torch.where(coverage > 0, 1 / coverage, 0.0).to(image), coverage
