"""Reading images at any position.

Samples are gathered by index, so everything is differentiable twice, forwards too, also in the positions; each tap is
a pixel and a weight.
Letters: `x y` pixel column and row.
"""

import torch
from torch import Tensor

from lfref.refocus.borders import ON_VIEW, Border, Tap
from lfref.refocus.interpolations import FARTHEST, Interpolation


def sample(images: Tensor, x: Tensor, y: Tensor, way: Interpolation, border: Border) -> tuple[Tensor, Tensor]:
    """Read images at any position.

    Args:
        images: Floating point, [..., H, W].
        x: Columns to read at, in pixels, float64, [P...].
        y: Rows to read at, in pixels, float64, [P...].
        way: How they are read between samples, by a few of them.
        border: What is beyond them.

    Returns:
        Samples, [..., P...], and whether each position has one, [P...]: where it lies on the image if only samples
        count, else everywhere.
    """
    taps, has_sample = [], torch.ones_like(x, dtype=torch.bool)
    for position, length in zip((y, x), images.shape[-2:], strict=True):
        place = (position + 0.5).floor() if way.rounds else position
        taps.append([border.tap(*tap, length) for tap in _taps(place, way)])
        if border.counts_only_samples:
            has_sample = has_sample & (place >= -ON_VIEW) & (place <= length - 1 + ON_VIEW)
    return _tapped(images, *taps), has_sample


def _taps(position: Tensor, way: Interpolation) -> list[Tap]:
    """As `Interpolation.taps`."""
    assert way.weights is not None, "this interpolation reads all samples"
    position = position.clamp(-FARTHEST, FARTHEST)
    whole = position.detach().floor()
    return [(whole.long() - way.before + i, weight) for i, weight in enumerate(way.weights(position - whole))]


def _tapped(images: Tensor, rows: list[Tap], columns: list[Tap]) -> Tensor:
    flat, width = images.flatten(-2), images.shape[-1]
    # A weight of 0 must not let inf or NaN through; checked once, as the guard costs more than the taps themselves.
    keep = _as_they_are if bool(images.detach().sum().isfinite()) else _where_they_count
    total = torch.zeros((), dtype=images.dtype, device=images.device)
    for row, row_weight in rows:
        for column, column_weight in columns:
            weight = (row_weight * column_weight).to(images)
            total = total + keep(_gathered(flat, row * width + column), weight) * weight
    return total


def _gathered(flat: Tensor, index: Tensor) -> Tensor:
    """Samples of [..., K] at an index [P...] that all leading dimensions share; far faster than `flat[..., index]`."""
    batch = flat.shape[:-1]
    return flat.gather(-1, index.reshape(-1).expand(*batch, -1)).reshape(*batch, *index.shape)


def _as_they_are(samples: Tensor, weight: Tensor) -> Tensor:
    return samples


def _where_they_count(samples: Tensor, weight: Tensor) -> Tensor:
    # Finite samples stay: the derivative by the position needs them, at weight 0 too.
    return torch.where(weight == 0, samples.nan_to_num(0.0, 0.0, 0.0), samples)
