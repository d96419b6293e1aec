"""What shows that an image with a lattice is one of lenslets, and of which kind of camera.

Photographs of bricks, tiles, fences and fabric have lattices too. What is different there:
- No lens and no wall is as straight as an array of lenslets (`lenslet_search` measures that).
- The image of the pupil is round: the mean of all cells depends on the distance from the centre alone (`roundness`).
- At the border between lenslets the direction jumps. Once each pixel is divided by the mean of its place in the cell, a
  photograph goes on there as anywhere else, while lenslets begin anew (`step`).
- Lenslets see the scene from several directions, so that there is detail in each (`parallax`), and the detail of one is
  seen again in the next (`repetition`). Mosaics and lamps in rows have none, threads and dots of a print their own.

A focused plenoptic camera (Lumsdaine & Georgiev 2009; Perwass & Wietzke 2012, the Raytrix with lenslets of three focal
lengths) has a small sharp picture of the scene behind each lenslet. Behind the lenslets of other cameras a scene is
never finer than the lenslets: what is seen again in the next lenslet has moved by less than the size of its structures.

Letters: `H W` pixel rows and columns, `i j` row and column of a lenslet, `y x` of a pixel.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import avg_pool2d

from lfref.io.lenslet_lattice import Lattice

MIDDLE = 1000
"""Side of the image's middle that is judged, in pixels."""
BINS = 24
"""Bins along each side of a mean cell, which is one and a half pitches wide."""
RADIAL_TERMS = 7
"""Terms of the polynomial in the squared distance that describes the round image of a pupil."""
DARK = 0.2
"""Share of the brightest place of a cell below which pixels do not count: there is hardly more than noise."""
STEP_DISTANCE = 2
"""Distance of the pixels whose difference is the step, in pixels: neighbours share light by blur and by compression."""
FEWEST_PAIRS = 500
"""Fewest pairs of pixels for a mean."""
ROUND = 0.9
"""Least roundness: lenslets have .95 to 1 (.7 if they show no dark gaps), bricks, tiles, fences, fabric up to .83."""
STEP = 1.5
"""Least step: lenslets have 1.55 to 5; a hexagonal fence before a scene, and dots of a print, have 1.4 to 1.49."""
ALIGNED_CONTRAST, ALIGNED_ROUND, ALIGNED_STEP = 0.1, 0.65, 1.4
"""Contrast of aligned lenslets from which the roundness counts, its least value, and their least step by neighbours.

Aligned lenslets have a step of 2.1 to 10, and a roundness of .9 to 1; photographs of a period of 14 pixels .2 to .5.
"""
PARALLAX = 0.16
"""Least variance of detail in lenslets, over that of steps between them: scenes of |slope| .1 have .19, mosaics .14."""
REPETITION = 0.45
"""Least correlation of detail with that of the next lenslet, without noise: scenes have .5 to 1, fences and dots .4."""
REPEATED = 0.45
"""Least correlation of neighbouring lenslets that counts as the same scene: .6 to .75, without shift up to .3."""
SHARP = 0.6
"""Width of structures, over their shift in the next lenslet, below which a camera is focused: .4 to .55; others .85."""
SHORTEST_SHIFT = 2.0
"""Shortest shift that counts, in pixels: structures are hardly narrower than a pixel."""
KINDS = 3
"""Number of focal lengths of a Raytrix; its lenslets of one kind are never neighbours."""
KIND_RATIO = 1.3
"""Sharpness of the sharpest kind over that of the least sharp from which kinds count: 1.6 to 10; other cameras 1.05."""


@dataclass(frozen=True)
class Cells:
    """The middle of an image, pixel by pixel, all [H, W]."""

    light: NDArray[np.float64]
    """Samples over the mean of their neighbourhood and over the mean of their place in the cell."""
    even: NDArray[np.float64]
    """Samples over the mean of their place in the cell."""
    gain: NDArray[np.float64]
    """Mean of the pixel's place in the cell, about 1 on average."""
    radius: NDArray[np.float64]
    """Distance from the centre of the lenslet, in pitches."""
    numbers: NDArray[np.int64]
    """Row and column of the lenslet, [2, H, W]."""
    roundness: float
    """Share of the variance of the mean cell that the distance from its centre explains."""
    lattice: Lattice
    """The lattice of the cells."""

    @property
    def contrast(self) -> float:
        """Standard deviation of the gain over its mean."""
        return float(self.gain.std() / self.gain.mean())

    def step(self, distance: int = STEP_DISTANCE) -> float:
        """Difference of pixels across the border of lenslets, over that within a lenslet; 0 if there is no border."""
        counts = self.gain > DARK * self.gain.max()
        sums = np.zeros((2, 2))
        for here, there in (_apart(0, distance), _apart(distance, 0)):
            both = counts[here] & counts[there]
            same = (self.numbers[:, *here] == self.numbers[:, *there]).all(axis=0)
            # A few strong edges of the scene would hide the rest.
            difference = np.minimum(abs(self.light[here] - self.light[there]), 2)
            for kind, chosen in enumerate((both & same, both & ~same)):
                sums[kind] += difference[chosen].sum(), chosen.sum()
        (inside, n_inside), (across, n_across) = sums
        if min(n_inside, n_across) < FEWEST_PAIRS or not inside:
            return 0.0
        return float(across / n_across * n_inside / inside)


def _apart(down: int, right: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Two windows of an image whose pixels are so far apart; steps may be negative."""
    rows, columns = (
        (slice(max(0, -step), -step if step > 0 else None), slice(max(0, step), step if step < 0 else None))
        for step in (down, right)
    )
    return (rows[0], columns[0]), (rows[1], columns[1])


def fold(image: NDArray, lattice: Lattice) -> Cells:
    """The cells of a lattice in the middle of an image [H, W]."""
    size = tuple(min(length, MIDDLE) for length in image.shape)
    top, left = ((image.shape[k] - size[k]) // 2 for k in (0, 1))
    middle = np.asarray(image[top : top + size[0], left : left + size[1]], np.float64)
    y, x = np.mgrid[top : top + size[0], left : left + size[1]].astype(float)
    rows, columns = np.linalg.solve(
        np.array([lattice.rows, lattice.columns]).T,
        np.stack([y - lattice.origin[0], x - lattice.origin[1]]).reshape(2, -1),
    ).reshape(2, *size)
    # The nearest lenslet is in the row above or below.
    radius, offset, numbers = np.full(size, np.inf), np.zeros((2, *size)), np.zeros((2, *size), np.int64)
    for i in (np.floor(rows), np.floor(rows) + 1):
        j = np.round(columns - (i % 2) / 2 * lattice.is_hexagonal)
        apart = np.stack([y, x]) - np.stack(lattice.centres(i, j))
        distance = np.hypot(*apart) / lattice.pitch[1]
        nearer = distance < radius
        radius[nearer] = distance[nearer]
        offset[:, nearer], numbers[:, nearer] = apart[:, nearer], np.stack([i, j])[:, nearer]

    reach, around = round(lattice.pitch[1]), torch.from_numpy(middle)[None]
    for along in ((1, 0), (0, 1)):
        window = 2 * reach * along[0] + 1, 2 * reach * along[1] + 1
        padding = reach * along[0], reach * along[1]
        around = avg_pool2d(around, window, 1, padding, count_include_pad=False)
    level = np.maximum(around[0].numpy(), 1e-9)
    fine, place = _mean_cell(middle, level, offset / lattice.pitch[1], math.ceil(3 * lattice.pitch[1]))
    gain = fine[place].reshape(size)
    even = middle / np.maximum(gain, DARK / 2 * gain.max() + 1e-9)
    coarse, place = _mean_cell(middle, level, offset / lattice.pitch[1], BINS)
    return Cells(even / level, even, gain, radius, numbers, _roundness(coarse, place, radius.ravel()), lattice)


def _mean_cell(middle: NDArray, level: NDArray, offset: NDArray, n_bins: int) -> tuple[NDArray, NDArray]:
    """The mean of all cells in bins, and the bin of each pixel, both flat."""
    bins = np.rint((offset / 1.5 + 0.5) * n_bins).clip(0, n_bins).astype(int)
    place = (bins[0] * (n_bins + 1) + bins[1]).ravel()
    return np.bincount(place, middle.ravel()) / np.maximum(np.bincount(place, level.ravel()), 1e-9), place


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


@dataclass(frozen=True)
class Detail:
    """What lenslets show within themselves: deviations of pixels from the mean of their lenslet, where it is bright."""

    parallax: float
    """Variance of the detail without noise, over that of the steps from one lenslet to the next."""
    correlation: float
    """Largest correlation of the detail with that of the next lenslet."""
    repetition: float
    """The same without noise."""
    shift: float
    """Distance of the correlated places in the two lenslets, in pixels."""
    width: float
    """Distance at which the detail correlates with itself by half as much as with the next pixel, in pixels."""
    kind_ratio: float
    """Sharpness of the sharpest of three kinds of lenslets, over that of the least sharp; 1 for square lattices."""


def measure_detail(cells: Cells) -> Detail:
    """The detail within the lenslets."""
    pitch = cells.lattice.pitch[1]
    i, j = cells.numbers - cells.numbers.reshape(2, -1).min(axis=1)[:, None, None]
    n_columns = int(j.max()) + 1
    lenslet, size = i * n_columns + j, (int(i.max()) + 1) * n_columns
    bright = cells.radius < 0.4
    n_pixels = np.bincount(lenslet.ravel(), bright.ravel(), size)
    whole = n_pixels >= 0.9 * n_pixels.max()
    mean = np.bincount(lenslet.ravel(), np.where(bright, cells.even, 0).ravel(), size) / np.maximum(n_pixels, 1)
    counts = bright & whole[lenslet]
    detail = np.where(counts, cells.even / np.maximum(mean, 1e-9)[lenslet] - 1, 0).clip(-2, 2)

    def products(lag: float, lenslets_apart: int) -> tuple[float, float]:
        """Correlation and covariance of pixels so far apart along a row of lenslets."""
        here, there = _apart(*(round(lag * step / pitch) for step in cells.lattice.columns))
        pairs = counts[here] & counts[there] & (i[here] == i[there]) & (j[there] - j[here] == lenslets_apart)
        if pairs.sum() < FEWEST_PAIRS:
            return 0.0, 0.0
        one, other = detail[here][pairs], detail[there][pairs]
        return float(one @ other / math.sqrt(max(float(one @ one * (other @ other)), 1e-30))), float(
            (one * other).mean()
        )

    # Noise correlates only with itself: all is measured from the next pixel on.
    along = [products(lag, 0) for lag in range(math.ceil(0.8 * pitch))]
    first, covariance = along[1]
    width = next((lag - 1 + (a - first / 2) / (a - b) for lag, a, b in _falling([one for one, _ in along])), math.inf)
    lags = np.arange(math.ceil(0.5 * pitch), math.floor(1.5 * pitch) + 1)
    repeated = [products(float(lag), 1)[0] for lag in lags]
    best = int(np.argmax(repeated))

    grid, is_whole = mean.reshape(-1, n_columns), whole.reshape(-1, n_columns)
    steps = 2 * (grid[:, 1:] - grid[:, :-1]) / np.maximum(grid[:, 1:] + grid[:, :-1], 1e-9)
    spread = float((steps[is_whole[:, 1:] & is_whole[:, :-1]] ** 2).mean())

    kind_ratio = 1.0
    if cells.lattice.is_hexagonal:
        here, there = _apart(0, 1)
        inside = counts[here] & counts[there] & (lenslet[here] == lenslet[there])
        kind = (cells.numbers[1] - np.floor_divide(cells.numbers[0], 2) - cells.numbers[0]) % KINDS
        edges = (detail[here] - detail[there]) ** 2
        sharpness = [float(edges[inside & (kind[here] == k)].mean()) for k in range(KINDS)]
        kind_ratio = max(sharpness) / max(min(sharpness), 1e-30)
    return Detail(
        parallax=covariance / max(spread, 1e-30),
        correlation=repeated[best],
        repetition=repeated[best] / first if first > 0 else 0.0,
        shift=abs(float(lags[best]) - pitch),
        width=width,
        kind_ratio=kind_ratio,
    )


def _falling(along: list[float]) -> Iterator[tuple[int, float, float]]:
    """Lags, from 2, at which a correlation falls below half of that of the next pixel, with both its values."""
    for lag in range(2, len(along)):
        if along[lag] < along[1] / 2 <= along[lag - 1]:
            yield lag, along[lag - 1], along[lag]


def has_parallax(detail: Detail) -> bool:
    """Whether lenslets see a scene from several directions."""
    return detail.parallax >= PARALLAX and detail.repetition >= REPETITION


def shows_lenslets(cells: Cells) -> bool:
    """Whether the lattice is one of lenslets with dark gaps, and not of a photograph."""
    return cells.roundness >= ROUND and cells.step() >= STEP and has_parallax(measure_detail(cells))


def shows_aligned_lenslets(cells: Cells) -> bool:
    """Whether an image that repeats at an aligned lattice has lenslets there, with or without dark gaps."""
    is_round = cells.contrast < ALIGNED_CONTRAST or cells.roundness >= ALIGNED_ROUND
    return is_round and cells.step(1) >= ALIGNED_STEP


def is_focused(detail: Detail) -> bool:
    """Whether lenslets are those of a focused plenoptic camera: sharp pictures that repeat in the next lenslet."""
    is_sharp = detail.shift >= SHORTEST_SHIFT and detail.width < SHARP * detail.shift
    return (is_sharp and detail.correlation > REPEATED) or detail.kind_ratio > KIND_RATIO
