"""Reading views at any position, and their mean over the aperture where the positions vary over the picture.

Samples are gathered by index, so everything is differentiable twice, forwards too, also in the positions; each tap is
a pixel and a weight.
Letters: `u v` view column and row, `x y` pixel column and row, `t` fraction of a pixel.
"""

import importlib
import importlib.util
from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import chosen
from lfref.refocus import batches
from lfref.refocus.borders import BORDERS
from lfref.refocus.interpolations import cubic_weights

Tap = tuple[Tensor, Tensor]
"""Index of a sample along one axis, and its weight, [P...] each."""

Positions = Callable[[int, int], tuple[Tensor, Tensor, Tensor | bool]]
"""(v, u) -> x and y in that view, in pixels, and where the view can see the point at all, [H, W] each."""

KERNEL = "lfref.refocus.anywhere.by_numba" if importlib.util.find_spec("numba") else None
"""The room that computes the same on the CPU where nobody asks for derivatives, if its compiler is installed."""

ON_VIEW = 1e-9  # pixels by which rounding may put a position beyond the outermost sample
FARTHEST = 2.0**50  # positions beyond have no fraction left, and soon no index


class Reading(NamedTuple):
    """One way to read an image between its samples."""

    snap: Callable[[Tensor], Tensor]
    """The position that is really read for a wanted one."""
    taps: Callable[[Tensor], list[Tap]]
    """(position) -> the samples around it."""


def _split(position: Tensor) -> tuple[Tensor, Tensor]:
    """Whole pixels as an index, and the fraction."""
    position = position.clamp(-FARTHEST, FARTHEST)
    whole = position.detach().floor()
    return whole.long(), position - whole


def _nearest_taps(position: Tensor) -> list[Tap]:
    whole, t = _split(position)
    return [(whole, torch.ones_like(t))]


def _linear_taps(position: Tensor) -> list[Tap]:
    whole, t = _split(position)
    return [(whole, 1 - t), (whole + 1, t)]


def _cubic_taps(position: Tensor) -> list[Tap]:
    whole, t = _split(position)
    return [(whole + i - 1, weight) for i, weight in enumerate(cubic_weights(t))]


READINGS: dict[str, Reading] = {
    "nearest": Reading(lambda position: (position + 0.5).floor(), _nearest_taps),
    "linear": Reading(lambda position: position, _linear_taps),
    "cubic": Reading(lambda position: position, _cubic_taps),
}
"""The local ones of `INTERPOLATIONS`: a Fourier shift moves a whole view by one distance."""


def _replicated(index: Tensor, weight: Tensor, length: int) -> Tap:
    return index.clamp(0, length - 1), weight


def _black(index: Tensor, weight: Tensor, length: int) -> Tap:
    within = index.clamp(0, length - 1)
    return within, torch.where(within == index, weight, 0.0)


def _periodic(index: Tensor, weight: Tensor, length: int) -> Tap:
    return index.remainder(length), weight


BEYOND: dict[str, Callable[[Tensor, Tensor, int], Tap]] = {
    "renormalize": _replicated,
    "edge": _replicated,
    "zero": _black,
    "wrap": _periodic,
}
"""(index, weight, length) -> a tap that exists, for each key of `BORDERS`."""


def sample(
    images: Tensor, x: Tensor, y: Tensor, interpolation: str = "linear", border: str = "renormalize"
) -> tuple[Tensor, Tensor]:
    """Read images at any position.

    Args:
        images: Floating point, [..., H, W].
        x: Columns to read at, in pixels, float64, [P...].
        y: Rows to read at, in pixels, float64, [P...].
        interpolation: `nearest`, `linear` or `cubic`.
        border: `renormalize`, `edge`, `zero` or `wrap`.

    Returns:
        Samples, [..., P...], and whether each position has one, [P...]: where it lies on the image for `renormalize`,
        everywhere for the others.

    Raises:
        InputError: An unknown border, or an interpolation that is unknown or not local (`exact`).
    """
    reading = chosen("interpolation at positions that vary over the picture", interpolation, READINGS)
    beyond, counts_only_samples = chosen("border", border, BEYOND), BORDERS[border].counts_only_samples
    taps, has_sample = [], torch.ones_like(x, dtype=torch.bool)
    for position, length in zip((y, x), images.shape[-2:], strict=True):
        place = reading.snap(position)
        taps.append([beyond(*tap, length) for tap in reading.taps(place)])
        if counts_only_samples:
            has_sample = has_sample & (place >= -ON_VIEW) & (place <= length - 1 + ON_VIEW)
    return _tapped(images, *taps), has_sample


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


def pixels(views: Tensor) -> tuple[Tensor, Tensor]:
    """Columns x [1, W] and rows y [H, 1] of the picture, in pixels, float64.

    Args:
        views: Anything [..., H, W].
    """
    rows, columns = (torch.arange(n, dtype=torch.float64, device=views.device) for n in views.shape[-2:])
    return columns[None], rows[:, None]


def mean_of_views(
    views: Tensor, aperture: Tensor, positions: Positions, interpolation: str, border: str
) -> tuple[Tensor, Tensor]:
    """Weighted mean, at each pixel, of the views that have a sample there; 0 where none has.

    Args:
        views: Light fields, floating point, uint8 or uint16, [B, V, U, C, H, W].
        aperture: Weights that sum to 1, [V, U]; a view of weight 0 is not read.
        positions: Where each view is to be read.
        interpolation: As in `sample`.
        border: As in `sample`.

    Returns:
        Images, float32 or float64, [B, C, H, W], and the share of the aperture that has a sample, float64, [H, W].

    Raises:
        InputError: As `sample`.
    """
    image = torch.zeros_like(batches.radiance(views[:, 0, 0]))
    coverage = torch.zeros(views.shape[-2:], dtype=torch.float64, device=views.device)
    for v, u in aperture.nonzero().tolist():
        x, y, visible = positions(v, u)
        samples, has_sample = sample(batches.radiance(views[:, v, u]), x, y, interpolation, border)
        counted, weight = has_sample & visible, float(aperture[v, u])
        image = image + torch.where(counted, samples, 0.0) * weight
        coverage = coverage + counted.to(coverage) * weight
    return image * torch.where(coverage > 0, 1 / coverage, 0.0).to(image), coverage


def kernel(*tensors: Tensor) -> ModuleType | None:
    """The room `by_numba` where it can serve these tensors, else None: then PyTorch's operations have to."""
    if KERNEL is None or not all(tensor.device.type == "cpu" and batches.is_plain(tensor) for tensor in tensors):
        return None
    # Imported here: a compiler takes half a second to load, which a program that never refocuses need not spend.
    return importlib.import_module(KERNEL)
