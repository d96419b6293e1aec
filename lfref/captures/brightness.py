"""Brightness of every view relative to the central one, in windows where both show the same part of the scene; and
exposure: views, or channels of them, that are brighter or darker throughout.

Views are reduced. Each view is read at the points of the central view, which the disparity of the central view locates.
Clipped samples and points beyond a view are unknown. `vignetting` is estimated from these ratios too; after its
correction, one gain for each view and channel remains, its exposure.
Letters: `V U` view rows and columns, `C` channels, `n` windows; `y x` places in half diagonals from a view's centre.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.captures import Defect, registration
from lfref.lightfield import LightField

REDUCTION = 4  # pixels: brightness changes slowly, and disparities of a pixel become fractions of one
WINDOWS = 24  # number along the longer side, by trial: small enough for a rim, large enough to average noise
LEAST_WINDOWS = 24  # windows that an estimate of brightness needs, by trial
CLIPPED = 0.98  # share of the brightest sample, or of 1, by trial: compression changes clipped samples a little
DARKEST = 0.03  # share of the mean light of the central view, by trial: ratios of less light are mostly noise
LEAST_RATIO = 0.02  # smaller ratios are raised to this one, so that logarithms are finite
SURE = 6.0  # standard errors from which a gain is certain, by trial
SHOWN = 0.02  # logarithm of a gain that shows: scenes without a defect, but with much occlusion, have up to .016
LEAST = 0.004  # least logarithm of a gain that is corrected if another shows: half a level of 8 bits at 1/2
CLEAR = 1.5  # least share of the scatter of windows that shows: occlusion and gloss look like gains of up to .8 of it
LIKELY = 0.5  # least share of the scatter of any other gain, once one shows, by trial
LARGEST = 1.5  # logarithm, by trial: a view with less than a fifth of the light has another defect
TILES = 5  # number along a side, by trial: tiles are larger than highlights and edges: errors are about independent


class Ratios(NamedTuple):
    """Brightness of the windows of the central view in each view."""

    log: Tensor  # logarithm of the brightness over that of the central view, 0 where unknown, [V, U, C, n]
    known: Tensor  # whether the brightness is known, [V, U, n]
    places: Tensor  # rows and columns of the windows in each view, in half diagonals from its centre, [2, V, U, n]
    views: Tensor  # positions of the views in view steps from the angular centre, rows and columns, [2, V, U, 1]
    shape: tuple[int, int]  # rows and columns of windows; n is their product
    centre: tuple[int, int]  # row and column of the view that all are compared with


def ratios(field: LightField, disparity: Tensor, centre: tuple[int, int]) -> Ratios:
    """Light of each view relative to the central view, whose `disparity` is in pixels per view step, [H, W]."""
    images = field.views.flatten(0, 1)
    # Samples are clipped at 1, or above it after white balance; white samples of a darker picture are not clipped.
    limits = CLIPPED * images[..., ::8, ::4].amax((0, 2, 3)).clamp(min=1)
    reduced = block_means(images, REDUCTION, limits)
    disparity = block_means(disparity[None, None].to(reduced), REDUCTION, torch.tensor([math.inf]))[0, 0] / REDUCTION
    views = registration.positions_of(field).unflatten(0, field.grid).movedim(-1, 0).to(reduced)
    v, u = (views - views[:, centre[0], centre[1], None, None])[..., None, None]
    # Where each view shows each reduced pixel of the central one, [V, U, h, w].
    rows = torch.arange(disparity.shape[0]).to(disparity)[:, None] + v * disparity
    columns = torch.arange(disparity.shape[1]).to(disparity) + u * disparity
    height, width = disparity.shape
    places = torch.stack([(2 * columns + 1) / width - 1, (2 * rows + 1) / height - 1], -1).flatten(0, 1)
    outside = (rows < 0) | (rows > height - 1) | (columns < 0) | (columns > width - 1)
    warped = F.grid_sample(reduced, places, padding_mode="border", align_corners=False)
    warped = warped.masked_fill_(outside.flatten(0, 1)[:, None], torch.nan).unflatten(0, field.grid)
    side = max(3, round(max(disparity.shape) / WINDOWS))
    light = _window_means(warped, side)
    central = light[centre]
    ratio = light / central
    bright = central > DARKEST * central.nanmean()
    known = (ratio.isfinite() & bright).all(2)
    if field.weight is not None:
        known &= (field.weight[..., ::4, ::4].flatten(2).amax(2) > 0)[..., None].to(known.device)
    log = torch.where(known[:, :, None], ratio, 1.0).clamp(min=LEAST_RATIO).log()
    half_diagonal = math.hypot(*field.size) / 2
    windows = [
        ((_window_means(place[:, :, None], side)[:, :, 0] + 0.5) * REDUCTION - length / 2) / half_diagonal
        for place, length in zip((rows, columns), field.size, strict=True)
    ]
    shape = (height // side, width // side)
    return Ratios(log, known, torch.stack(windows), views[..., None], shape, centre)


def _window_means(maps: Tensor, side: int) -> Tensor:
    """Means of square windows of maps, [V, U, C, n]."""
    return F.avg_pool2d(maps.flatten(0, 1), side).flatten(2).unflatten(0, maps.shape[:2])


def block_means(images: Tensor, factor: int, limits: Tensor) -> Tensor:
    """Means of square blocks of images [B, C, H, W]; NaN where a sample is, or reaches its channel's limit [C]."""
    is_clipped = F.max_pool2d(images, factor) >= limits.to(images)[:, None, None]
    height, width = is_clipped.shape[-2:]
    blocks = images[..., : height * factor, : width * factor].unflatten(-1, (width, factor))
    # Columns first, then rows, always in this order: the estimate of vignetting shows the last bit of these sums.
    columns = sum(blocks.unflatten(-3, (height, factor)).unbind(-3), images.new_zeros(()))
    means = sum(columns.unbind(-1), images.new_zeros(())) / factor**2
    return means.masked_fill(is_clipped, torch.nan)


@dataclass(frozen=True, eq=False)
class ExposureDefect(Defect):
    """Brightness of every view and channel, relative to the central view."""

    name = "exposure"
    needs_light = True

    gains: Tensor  # brightness over that of the central view, 1 where no difference is certain, float64, [V, U, C]
    error: float  # standard error of a gain, the median over views and channels

    def summary(self) -> str:
        """Range of the gains, and their error."""
        is_other = (self.gains != 1).any(2)
        span = f"{self.gains.min():.3f} to {self.gains.max():.3f}"
        return f"{is_other.sum()} of {is_other.numel()} views: {span} of the central one's light, to {self.error:.2%}"

    def corrected(self, field: LightField) -> LightField:
        """Views divided by their gains."""
        gains = self.gains[..., None, None].to(field.views)
        return dataclasses.replace(field, views=field.views / gains)


def find_exposure(ratios: Ratios) -> ExposureDefect | str:
    """Estimate the gain of every view and channel, in a field without vignetting."""
    level, error, scatter = levels(ratios)
    is_enough = (ratios.known.sum(2, keepdim=True) >= LEAST_WINDOWS).expand_as(error)
    typical = float(error[is_enough].median()) if bool(is_enough.any()) else 0.0
    gains = certain_gains(level, error.masked_fill(~is_enough, torch.inf), scatter)
    return ExposureDefect(gains, typical) if bool((gains != 1).any()) else f"views and colours agree to {typical:.2%}"


def certain_gains(level: Tensor, error: Tensor, scatter: Tensor) -> Tensor:
    """Gains from their logarithms, standard errors and the scatter of windows, [V, U, C] each.

    Where none is certain a gain is 1; all are 1 if none shows. Views of a scene with much occlusion differ in what they
    show: then windows scatter, and their mean errs by more than independent windows would.
    """
    size = level.abs()
    is_sure = (size > SURE * error) & (size < LARGEST)
    if not bool((is_sure & (size > SHOWN) & (size > CLEAR * scatter)).any()):
        return torch.ones_like(level, dtype=torch.float64, device="cpu")
    return torch.where(is_sure & (size > LEAST) & (size > LIKELY * scatter), level.exp(), 1.0).cpu().double()


def levels(ratios: Ratios) -> tuple[Tensor, Tensor, Tensor]:
    """Robust mean of the logarithms of each view and channel, its standard error, and their scatter, [V, U, C] each."""
    known = ratios.known[:, :, None].expand_as(ratios.log)
    level = torch.where(known, ratios.log, torch.nan).nanmedian(3, keepdim=True).values.nan_to_num()
    # Two standard deviations, from the median deviation: values farther out hardly count.
    scale = 2 * 1.4826 * torch.where(known, (ratios.log - level).abs(), torch.nan).nanmedian(3, keepdim=True).values
    scale = scale.nan_to_num().clamp(min=1e-3)
    for _ in range(10):  # number of rounds by trial
        weight = known / (1 + ((ratios.log - level) / scale).square()).square()
        total = weight.sum(3, keepdim=True).clamp(min=1e-6)
        level = (weight * ratios.log).sum(3, keepdim=True) / total
    rows, columns = ratios.shape
    row_tiles, column_tiles = torch.arange(rows) * TILES // rows, torch.arange(columns) * TILES // columns
    tiles = (row_tiles[:, None] * TILES + column_tiles).flatten()
    pulls = torch.zeros(*level.shape[:3], TILES**2).to(level)
    pulls.index_add_(3, tiles.to(pulls.device), weight * (ratios.log - level))
    return level[..., 0], (pulls / total).square().sum(3).sqrt(), scale[..., 0] / 2
