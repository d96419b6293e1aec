"""What shows that an image with a lattice is one of lenslets, and of which kind of camera.

Photographs of bricks, tiles, fences and fabric have lattices too. What is different there:
- The image of the pupil is round: the mean of all cells depends on the distance from the centre alone.
- Lenslets see the scene from several directions, so that there is detail in each (parallax), and the detail of one is
  seen again in the next (repetition). Mosaics and lamps in rows have none, threads and dots of a print their own.
- Lenslets that are aligned with the pixels need no dark gaps: the direction jumps from the last pixel of one to the
  first of the next (`borders`), while a photograph goes on there as anywhere else.

A focused plenoptic camera (Lumsdaine & Georgiev 2009; Perwass & Wietzke 2012) has a small sharp picture of the scene
behind each lenslet. Behind others, detail that repeats has moved by less than the size of its structures.
Letters: `H W` pixel rows and columns, `i j` row and column of a lenslet, `y x` of a pixel.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from lfref.functional import neighbours
from lfref.io.lenslet_lattice import Lattice

MIDDLE, BINS, RADIAL_TERMS = 700, 24, 7
"""Side of the middle that is judged, in pixels; bins along each side of a mean cell, which is one and a half pitches
wide; terms of the polynomial in the squared distance that describes the round image of a pupil."""
DARK = 0.1
"""Share of the brightest place of a cell to which darker places are raised: there is hardly more than noise."""
BRIGHT_RADIUS = 0.4
"""Distance from the centre of a lenslet up to which its detail counts, in pitches."""
FEWEST_PAIRS = 500
"""Fewest pairs of pixels for a correlation."""
ROUND = 0.9
"""Least roundness: lenslets have .95 to 1, bricks, tiles, fences and fabric up to .89, aligned ones .2 to .85."""
CONTRAST = 0.1
"""Contrast of aligned lenslets from which the roundness counts: without dark gaps there is nothing round."""
PARALLAX = 0.16
"""Least variance of detail in lenslets, over that of steps between them: scenes have .2 and more, mosaics .15."""
REPETITION = 0.45
"""Least correlation of detail with that of the next lenslet, without noise: scenes have .5 to 1, dots .4."""
SHARP = 0.6
"""Width of structures, over their shift in the next lenslet, below which a camera is focused: .4 to .55; others .85."""
SHORTEST_SHIFT = 2.0
"""Shortest shift that counts, in pixels: structures are hardly narrower than a pixel."""
BORDER = 1.4
"""Least difference of pixels across the borders of aligned lenslets, over that of others: captures have 2 to 10."""
STRIPS, THICKNESS, STRIP_LENGTH = 12, 6, 4096
"""Number of strips of an image along each axis, width of a strip, and its largest length, in pixels."""
SHORTEST_PITCH, LONGEST_PITCH = 3, 64
"""Range of the pitches of aligned lenslets that are measured, in pixels."""


class Cells(NamedTuple):
    """What the cells of a lattice show in the middle of an image."""

    roundness: float
    """Share of the variance of the mean cell that the distance from its centre explains."""
    contrast: float
    """Standard deviation of the mean cell over its mean."""
    parallax: float
    """Variance of the detail within cells, without noise, over that of the steps from one cell to the next."""
    repetition: float
    """Largest correlation of the detail with that of the next cell, without noise."""
    shift: float
    """Distance of the correlated places in the two cells, in pixels."""
    width: float
    """Distance at which the detail correlates with itself by half as much as with the next pixel, in pixels."""

    @property
    def show_lenslets(self) -> bool:
        """Whether the cells are lenslets with dark gaps, and not those of a photograph."""
        return self.roundness >= ROUND and self.parallax >= PARALLAX and self.repetition >= REPETITION

    @property
    def are_focused(self) -> bool:
        """Whether the cells are lenslets of a focused camera."""
        is_sharp = self.shift >= SHORTEST_SHIFT and self.width < SHARP * self.shift
        return is_sharp and self.parallax >= PARALLAX and self.repetition >= REPETITION


def measure(image: NDArray, lattice: Lattice) -> Cells:
    """What the cells of a lattice show in the middle of an image [H, W]."""
    pitch = lattice.pitch[1]
    height, width = (min(length, MIDDLE) for length in image.shape)
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    light = np.asarray(image[top : top + height, left : left + width], np.float64)
    y, x = np.mgrid[top : top + height, left : left + width]
    i, j = lattice.nearest(y, x)
    offset = np.stack([y, x]) - lattice.centres(i, j)
    radius = np.hypot(*offset) / pitch

    around = neighbours.box_mean(torch.from_numpy(light)[None], 2 * round(pitch) + 1)[0].numpy()
    mean_cell, place = _mean_cell(light, around, offset / pitch, math.ceil(3 * pitch))
    gain = mean_cell[place]
    coarse, place = _mean_cell(light, around, offset / pitch, BINS)
    roundness = _roundness(coarse, place.ravel(), radius.ravel())

    # Detail: deviations of pixels from the mean of their lenslet, where it is bright.
    even = light / np.maximum(gain, DARK * gain.max() + 1e-9)
    row, column = (i - i.min()).astype(int), (j - j.min()).astype(int)
    shape = int(row.max()) + 1, int(column.max()) + 1
    lenslet, bright = row * shape[1] + column, radius < BRIGHT_RADIUS
    n_pixels = np.bincount(lenslet.ravel(), bright.ravel(), math.prod(shape))
    is_whole = n_pixels >= 0.9 * n_pixels.max()
    mean = np.bincount(lenslet.ravel(), (even * bright).ravel(), math.prod(shape)) / np.maximum(n_pixels, 1)
    counts = bright & is_whole[lenslet]
    detail = np.where(counts, even / np.maximum(mean, 1e-9)[lenslet] - 1, 0).clip(-2, 2)

    def products(lag: float, lenslets_apart: int) -> tuple[float, float]:
        """Correlation and covariance of pixels so far apart along a row of lenslets."""
        here, there = _apart(*(round(lag * step / pitch) for step in lattice.columns))
        pairs = counts[here] & counts[there] & (row[here] == row[there])
        pairs &= column[there] - column[here] == lenslets_apart
        if pairs.sum() < FEWEST_PAIRS:
            return 0.0, 0.0
        one, other = detail[here][pairs], detail[there][pairs]
        covariance = float((one * other).mean())
        return covariance / math.sqrt(max(float((one * one).mean() * (other * other).mean()), 1e-30)), covariance

    # Noise correlates only with itself: all is measured from the next pixel on.
    first, covariance = products(1, 0)
    along = [first, *(products(lag, 0)[0] for lag in range(2, math.ceil(0.8 * pitch)))]
    falls = (lag + (a - first / 2) / (a - b) for lag, (a, b) in enumerate(pairwise(along), 1) if b < first / 2 <= a)
    lags = np.arange(math.ceil(0.5 * pitch), math.floor(1.5 * pitch) + 1)
    repeated = [products(float(lag), 1)[0] for lag in lags]
    best = int(np.argmax(repeated))

    means, whole = mean.reshape(shape), is_whole.reshape(shape)
    steps = 2 * np.diff(means, axis=1) / np.maximum(means[:, 1:] + means[:, :-1], 1e-9)
    spread = float((steps[whole[:, 1:] & whole[:, :-1]] ** 2).mean())
    return Cells(
        roundness=roundness,
        contrast=float(gain.std() / gain.mean()),
        parallax=covariance / max(spread, 1e-30),
        repetition=repeated[best] / first if first > 0 else 0.0,
        shift=abs(float(lags[best]) - pitch),
        width=next(falls, math.inf),
    )


def _apart(down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Two windows of an image whose pixels are so far apart; steps may be negative."""
    rows, columns = (
        (slice(max(0, -step), -step if step > 0 else None), slice(max(0, step), step if step < 0 else None))
        for step in (down, right)
    )
    return (rows[0], columns[0]), (rows[1], columns[1])


def _mean_cell(light: NDArray, around: NDArray, offset: NDArray, n_bins: int) -> tuple[NDArray, NDArray]:
    """The mean of all cells in bins, relative to the light around, and the bin of each pixel [H, W]."""
    bins = np.rint((offset / 1.5 + 0.5) * n_bins).clip(0, n_bins).astype(int)
    place = bins[0] * (n_bins + 1) + bins[1]
    sums = [np.bincount(place.ravel(), values.ravel()) for values in (light, np.maximum(around, 1e-9))]
    return sums[0] / np.maximum(sums[1], 1e-9), place


def _roundness(cell: NDArray, place: NDArray, radius: NDArray) -> float:
    """Share of a mean cell's variance that a polynomial in the squared radius explains, weighted by its pixels."""
    n_pixels = np.bincount(place)
    exists = n_pixels > 0
    squares = (np.bincount(place, radius) / np.maximum(n_pixels, 1))[exists] ** 2
    root = np.sqrt(n_pixels[exists])
    design = np.vander(squares, RADIAL_TERMS) * root[:, None]
    target = (cell[exists] - np.average(cell[exists], weights=root**2)) * root
    rest = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    return 1 - float(rest @ rest) / max(float(target @ target), 1e-30)


def steps_along(image: NDArray, axis: int) -> NDArray | None:
    """Mean difference of each pixel from the next along an axis of an image [H, W]; None if it is too flat or small."""
    if image.shape[axis] < 2 * SHORTEST_PITCH:
        return None
    rows = image if axis else image.T
    left = max(0, rows.shape[1] - STRIP_LENGTH) // 2
    tops = np.unique(np.linspace(0, max(0, len(rows) - THICKNESS), STRIPS).astype(int))
    strips = np.concatenate([rows[top : top + THICKNESS] for top in tops])
    # Whole lenslets are counted from the image's corner.
    steps = np.abs(np.diff(strips[:, : left + STRIP_LENGTH], axis=1))
    mean = steps.mean(axis=1, keepdims=True)
    if (mean > 0).sum() < THICKNESS:
        return None
    # A few strong edges of the scene would hide the rest.
    return np.minimum(steps[mean[:, 0] > 0] / mean[mean[:, 0] > 0], 3).mean(axis=0)


def borders(steps: NDArray, pitch: int) -> float:
    """Mean of the steps across the borders of aligned lenslets, over that of others; 1 if the pitch is another."""
    at = np.arange(1, len(steps) + 1)
    is_border = at % pitch == 0

    def ratio(one: NDArray, other: NDArray) -> float:
        return float(steps[one].mean() / max(steps[other].mean(), 1e-9)) if one.any() and other.any() else 1.0

    # Borders of half the pitch, or every second one of this pitch, are no borders of this pitch.
    finer = any(
        ratio(~is_border & (at % part == 0), ~is_border & (at % part > 0)) >= BORDER
        for part in range(SHORTEST_PITCH, pitch)
        if pitch % part == 0
    )
    coarser = any(ratio(at % (n * pitch) == 0, is_border & (at % (n * pitch) > 0)) >= BORDER for n in (2, 3))
    return 1.0 if finer or coarser else ratio(is_border, ~is_border)


def aligned_pitch(along: list[NDArray]) -> int | None:
    """The pitch of aligned lenslets that the steps along both axes show; None if they show none."""
    longest = min(LONGEST_PITCH, *(len(steps) // 2 for steps in along))
    scores = {n: min(borders(steps, n) for steps in along) for n in range(SHORTEST_PITCH, longest + 1)}
    best = max(scores, key=lambda n: scores[n], default=None)
    return best if best is not None and scores[best] >= BORDER else None
