"""The tables that compiled loops take of layers whose rays are followed.

Letters: as in `ray_loop`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.jit import compiled, inlined
from lfref.simulator.canvases import OVERSAMPLING, Box
from lfref.simulator.layers import Highlight, Layer

# PART ray_loop
# The compiled loops that follow rays one by one, along a row of pixels at a time.
#
# They serve surfaces that are slanted or curved, highlights, mirrored pictures, and surfaces that cross.
# Letters: `k` layer from far to near, `n` picture of an atlas, `x` pixel of the row, `X Y D` as in `surfaces`.

NEWTON_STEPS = 30
CONVERGED = 1e-10
"""Pixels per view step that a disparity found by Newton's method may still change by."""
DARK = 20.0
"""Where a highlight is exp(-DARK) of its top, it ends."""

Integers = NDArray[np.int64]
Marks = NDArray[np.bool_]
Reals = NDArray[np.floating]
Wide = NDArray[np.float64]


class Atlas(NamedTuple):
    """Pictures one after the other."""

    samples: Reals
    """Premultiplied RGBA, the channels of a sample side by side, [all]."""
    frames: Integers
    """Place of its first value, rows, columns, Y and X of its first sample in samples, [n, 5]."""


class Sights(NamedTuple):
    """Layers whose rays are followed, from far to near."""

    forms: Wide
    """Numbers of `surfaces.Form`, [K, 7]."""
    spans: Wide
    """Least and greatest disparity that any ray meets, [K, 2]."""
    boxes: Wide
    """X and Y of the first, then of the last point that is not transparent, [K, 4]."""
    pictures: Integers
    """Picture in the atlas, and picture mirrored or -1, [K, 2]."""
    mirrors: Wide
    """Share and disparity of the mirrored picture, [K, 2]."""
    lobes: Wide
    """Numbers of `layers.Highlight`, its width 0 where there is none, [K, 7]."""
    faces: Marks
    """Whether it faces the camera, [K]."""
    hides: Marks
    """Whether it is opaque all over, [K]."""


class Row(NamedTuple):
    """Rays through one aperture point to a row of pixels."""

    p: float
    q: float
    x: float
    """Of the first pixel, displaced by the slope times p."""
    y: float
    """Of the row, likewise."""
    slope: float
    """Of the picture in pixels per view step; 0 for a view."""
    cell: float
    """Width in view steps of what the aperture point stands for; 0 for a view."""


@compiled
def reached(sights: Sights, k: int, row: Row, width: int) -> tuple[int, int]:
    """First pixel of a row at which a layer may be seen, and one past the last."""
    near, far = sights.spans[k, 0], sights.spans[k, 1]
    left, top, right, bottom = sights.boxes[k, 0], sights.boxes[k, 1], sights.boxes[k, 2], sights.boxes[k, 3]
    high, low = row.y - min(near * row.q, far * row.q), row.y - max(near * row.q, far * row.q)
    if high < top or low > bottom:
        return 0, 0
    begin = left - row.x + min(near * row.p, far * row.p)
    stop = right - row.x + max(near * row.p, far * row.p) + 1
    return int(min(max(begin, 0.0), float(width))), int(min(max(np.ceil(stop), 0.0), float(width)))


@compiled
def meet(sights: Sights, k: int, row: Row, begin: int, stop: int, at: Wide) -> None:
    """Where rays meet a layer.

    Args:
        sights: The layers.
        k: Which.
        row: The rays.
        begin: First pixel.
        stop: One past the last pixel.
        at: Filled between them with X, Y, D and the slopes of D along x and y, [5, W].
    """
    form = sights.forms[k]
    disparity, a, b = form[0], form[1], form[2]
    share = 1 / (1 + a * row.p + b * row.q)
    for x in range(begin, stop):
        at[2, x] = (disparity + a * (row.x + x) + b * row.y) * share
        at[3, x], at[4, x] = a * share, b * share
    if form[3] != 0:
        _climb(form, row, begin, stop, at)
    for x in range(begin, stop):
        at[0, x] = row.x + x - at[2, x] * row.p
        at[1, x] = row.y - at[2, x] * row.q


@compiled
def _climb(form: Wide, row: Row, begin: int, stop: int, at: Wide) -> None:
    """From a plane to the bump on it, by Newton's method, each pixel starting with what the bump added before it."""
    _, a, b, bulge, radius, centre_x, centre_y = form
    added = 0.0
    for x in range(begin, stop):
        plane = at[2, x]
        found = plane + added
        for _ in range(NEWTON_STEPS):
            at_x, at_y = row.x + x - found * row.p, row.y - found * row.q
            off_x, off_y = (at_x - centre_x) / radius, (at_y - centre_y) / radius
            rise = max(1 - off_x * off_x - off_y * off_y, 0.0)
            steep = -4 * bulge / radius * rise
            across, down = a + steep * off_x, b + steep * off_y
            share = 1 / (1 + across * row.p + down * row.q)
            step = (found - form[0] - a * at_x - b * at_y - bulge * rise * rise) * share
            found -= step
            if abs(step) < CONVERGED:
                break
        at[2, x], at[3, x], at[4, x], added = found, across * share, down * share, found - plane


@compiled
def shine(sights: Sights, k: int, row: Row, begin: int, stop: int, at: Wide, rgba: Reals) -> None:
    """Add a layer's highlight, spread by the way that it moves within a cell; arguments as for `meet`.

    Args:
        sights: As there.
        k: As there.
        row: As there.
        begin: As there.
        stop: As there.
        at: As filled there.
        rgba: Changed, [4, W].
    """
    lobe = sights.lobes[k]
    width, drift = lobe[3], lobe[4]
    centre_x, centre_y = lobe[5] + drift * row.p, lobe[6] + drift * row.q
    red, green, blue = rgba.dtype.type(lobe[0]), rgba.dtype.type(lobe[1]), rgba.dtype.type(lobe[2])
    for x in range(begin, stop):
        way = (row.slope - at[2, x] - drift) * row.cell
        variance = width * width + way * way / 12
        fall = ((at[0, x] - centre_x) ** 2 + (at[1, x] - centre_y) ** 2) / (2 * variance)
        if fall < DARK:
            light = rgba.dtype.type(np.exp(-fall) * width * width / variance) * rgba[3, x]
            rgba[0, x] += red * light
            rgba[1, x] += green * light
            rgba[2, x] += blue * light


@compiled
def lay(rgba: Reals, begin: int, stop: int, sight: Reals) -> None:
    """Lay a layer over what is seen so far.

    Args:
        rgba: The layer, [4, W].
        begin: First pixel.
        stop: One past the last pixel.
        sight: Changed between them, [3, W].
    """
    one = rgba.dtype.type(1)
    for c in range(3):
        for x in range(begin, stop):
            sight[c, x] = rgba[c, x] + (one - rgba[3, x]) * sight[c, x]


@compiled
def lay_ranked(rgba: Reals, disparities: Wide, order: Integers, sight: Reals) -> None:
    """Lay layers over one another, at each pixel in the order of their disparities.

    Args:
        rgba: The layers, 0 where they are not seen, [K, 4, W].
        disparities: What each pixel sees of them, [K, W].
        order: Room for a number each, [K].
        sight: Filled, [3, W].
    """
    one = rgba.dtype.type(1)
    for x in range(sight.shape[1]):
        red = green = blue = rgba.dtype.type(0)
        for place in range(_ranked(rgba[:, 3, x], disparities[:, x], order)):
            k = order[place]
            passed = one - rgba[k, 3, x]
            red = rgba[k, 0, x] + passed * red
            green = rgba[k, 1, x] + passed * green
            blue = rgba[k, 2, x] + passed * blue
        sight[0, x], sight[1, x], sight[2, x] = red, green, blue


@inlined
def _ranked(opacities: Reals, disparities: Wide, order: Integers) -> int:
    """Fill in the layers that are not transparent from far to near; how many these are."""
    count = 0
    for k in range(opacities.size):
        if opacities[k] != 0:
            place = count
            while place > 0 and disparities[order[place - 1]] > disparities[k]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = k
            count += 1
    return count


@compiled
def lay_shared(rgba: Reals, at: Wide, crosses: Marks, row: Row, shares: Reals, sight: Reals) -> None:
    """Lay layers over one another, at each pixel in the order of their disparities.

    Of two layers that cross, each is the nearer one in a part of a cell, if their disparities differ by less than they
    do across it. All parts of a layer's light pass what is before it.

    Args:
        rgba: The layers, 0 where they are not seen, [K, 4, W].
        at: What each pixel sees of them: X, Y, D and its slopes along x and y, [K, 5, W].
        crosses: Pairs of layers that cross, [K, K].
        row: The rays.
        shares: Room for a row, [W].
        sight: Filled, [3, W].
    """
    sight[:] = 0
    for k in range(len(rgba)):
        shares[:] = 1
        for m in range(len(rgba)):
            if m != k:
                _veil(rgba[m, 3], at[m], at[k], m > k, crosses[m, k], row, shares)
        for c in range(3):
            for x in range(sight.shape[1]):
                sight[c, x] += shares[x] * rgba[k, c, x]


@compiled
def _veil(opacity: Reals, veil: Wide, behind: Wide, is_later: bool, crosses: bool, row: Row, shares: Reals) -> None:
    """Take from the light of one layer what another one keeps back."""
    for x in range(shares.size):
        lead = veil[2, x] - behind[2, x]
        before = 1.0 if lead > 0 or (lead == 0 and is_later) else 0.0
        if crosses:
            across, down = veil[3, x] - behind[3, x], veil[4, x] - behind[4, x]
            e = row.slope - (veil[2, x] + behind[2, x]) / 2
            spread = abs(e) * row.cell * np.sqrt(across * across + down * down)
            before = min(max(0.5 + lead / spread, 0.0), 1.0) if abs(lead) < spread else before
        shares[x] *= 1 - shares.dtype.type(before) * opacity[x]


@inlined
def sample_position(frame: Integers, at_x: float, at_y: float) -> tuple[float, float]:
    """Column and row in a picture of a point (X, Y)."""
    return at_x * OVERSAMPLING - frame[4], at_y * OVERSAMPLING - frame[3]


NO_LOBE = Highlight(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Page(NamedTuple):
    """Samples, and where they lie on a surface."""

    samples: NDArray[np.floating]
    """Premultiplied RGBA in the order in which loops want it, [h, w, 4] or [4, h, w]."""
    opacity: NDArray[np.floating]
    """The part of it that is opacity, [h, w]."""
    top: int
    """Y of the first row in samples."""
    left: int
    """X of the first column in samples."""


def atlas(pictures: Sequence[Page]) -> Atlas:
    """Put pictures one after the other."""
    arrays = [picture.samples.reshape(-1) for picture in pictures]
    starts = np.cumsum([0, *(array.size for array in arrays)])[:-1]
    frames = [
        (start, *picture.opacity.shape, picture.top, picture.left)
        for start, picture in zip(starts, pictures, strict=True)
    ]
    samples = np.concatenate(arrays) if arrays else np.zeros(0, np.float32)
    return Atlas(samples, np.array(frames, np.int64).reshape(-1, 5))


def sights(
    layers: Sequence[Layer],
    spans: Sequence[tuple[float, float]],
    boxes: Sequence[Box],
    pictures: Sequence[tuple[int, int]],
) -> Sights:
    """Describe layers.

    Args:
        layers: From far to near.
        spans: Least and greatest disparity that any ray meets of each.
        boxes: Where each may be seen.
        pictures: Place in an atlas of each one's picture, and of the picture that it mirrors or -1.
    """
    mirrors = [layer.reflection[1:] if layer.reflection else (0.0, 0.0) for layer in layers]
    return Sights(
        _table([layer.surface.geometry.form for layer in layers], 7),
        _table(spans, 2),
        _table(boxes, 4),
        np.array(pictures, np.int64).reshape(-1, 2),
        _table(mirrors, 2),
        _table([layer.highlight or NO_LOBE for layer in layers], 7),
        np.array([layer.surface.geometry.is_parallel for layer in layers], np.bool_),
        np.array([layer.hides for layer in layers], np.bool_),
    )


def _table(rows: Sequence[tuple[float, ...]], n_columns: int) -> NDArray[np.float64]:
    return np.array(rows, np.float64).reshape(-1, n_columns)


def box(picture: Page, margin: float) -> Box:
    """Where a picture may be seen that goes on beyond its ends.

    Args:
        picture: Whose opacity counts.
        margin: Pixels that are looked at around a point.
    """
    is_seen, left, top = picture.opacity != 0, math.inf, math.inf
    right, bottom = -math.inf, -math.inf
    if is_seen.any():
        top, bottom = _seen(is_seen.any(axis=1), picture.top, margin)
        left, right = _seen(is_seen.any(axis=0), picture.left, margin)
    return left, top, right, bottom


def _seen(is_seen: NDArray[np.bool_], start: int, margin: float) -> tuple[float, float]:
    """First and last place that is seen, in pixels, without end where the outermost ones are."""
    places = np.flatnonzero(is_seen)
    first, last = int(places[0]), int(places[-1])
    low = -math.inf if first == 0 else (first + start) / OVERSAMPLING - margin
    high = math.inf if last == len(is_seen) - 1 else (last + start) / OVERSAMPLING + margin
    return low, high
