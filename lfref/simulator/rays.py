"""Layers whose rays are followed one by one: their tables, and the compiled loops along a row of pixels.

They serve surfaces that are slanted or curved, highlights, mirrored pictures, and surfaces that cross. For each layer
and row, the loops compute the pixels at which the layer may be visible (`visible_pixels`), the points where rays meet
it (`intersect`), and its highlight (`add_highlight`). Then they composite the layers: in a fixed order, by depth at
each pixel, or by depth in parts of a cell. Compiled code takes plain arrays only: `RayLayers` describes the layers, an
`Atlas` holds their bitmaps.
Letters: `k m` layers from far to near, `n` bitmap of the atlas, `x` pixel of the row, `X Y D p q` as in `surfaces`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.functional.loops import compiled, inlined
from lfref.simulator.bitmaps import Box, Floats
from lfref.simulator.layers import Highlight, Layer, is_backdrop

Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
Float64s = NDArray[np.float64]


class AtlasEntry(NamedTuple):
    """A bitmap to be put into an atlas."""

    samples: NDArray[np.floating]  # premultiplied RGBA as loops read it: [h, w, 4], or [4, h, w] to be shifted
    opacity: NDArray[np.floating]  # [h, w]
    top: int  # Y of the first row in samples
    left: int  # X of the first column in samples


class Atlas(NamedTuple):
    """A texture atlas: bitmaps one after the other in one array."""

    samples: Floats  # premultiplied RGBA of all bitmaps, [all]
    density: int  # samples per pixel along each axis
    frames: Integers  # of each: index of the first value, rows, columns, Y and X of the first sample in samples, [n, 5]


class RayLayers(NamedTuple):
    """Layers whose rays are followed, from far to near, as arrays."""

    forms: Float64s  # parameters of `surfaces.Form`, [K, 7]
    spans: Float64s  # least and greatest disparity that any ray meets, [K, 2]
    boxes: Float64s  # X and Y of the first, then of the last point that is not transparent, [K, 4]
    bitmaps: Integers  # index in the atlas of the layer's bitmap, and of the mirrored picture or -1, [K, 2]
    mirrors: Float64s  # share and disparity of the mirrored picture, [K, 2]
    highlights: Float64s  # parameters of `layers.Highlight`, of width 0 where there is none, [K, 7]
    is_parallel: Bools  # whether each layer faces the camera, [K]
    is_backdrop: Bools  # whether each layer is opaque all over, [K]


class RayRow(NamedTuple):
    """Rays through one aperture point to a row of pixels."""

    p: float
    q: float
    x: float  # x of the first pixel, displaced by slope times p
    y: float  # y of the row, displaced by slope times q
    slope: float  # slope of the picture in pixels per view step; 0 for a view
    cell: float  # width in view steps of the aperture cell for which the point stands; 0 for a view


def atlas(entries: Sequence[AtlasEntry], density: int) -> Atlas:
    """Put bitmaps of `density` samples per pixel one after the other."""
    arrays = [entry.samples.reshape(-1) for entry in entries]
    starts = np.cumsum([0, *(array.size for array in arrays)])[:-1]
    frames = [
        (start, *entry.opacity.shape, entry.top, entry.left) for start, entry in zip(starts, entries, strict=True)
    ]
    samples = np.concatenate(arrays) if arrays else np.zeros(0, np.float32)
    return Atlas(samples, density, np.array(frames, np.int64).reshape(-1, 5))


def ray_layers(
    layers: Sequence[Layer], spans: Sequence[tuple[float, float]], boxes: Sequence[Box],
    bitmaps: Sequence[tuple[int, int]],
) -> RayLayers:  # fmt: skip
    """Arrays that describe layers; the arguments are the fields of the same names, row by row."""
    none = Highlight(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def table(rows: Sequence[tuple[float, ...]], n_columns: int) -> Float64s:
        return np.array(rows, np.float64).reshape(-1, n_columns)

    return RayLayers(
        table([layer.surface.geometry.form for layer in layers], 7),
        table(spans, 2),
        table(boxes, 4),
        np.array(bitmaps, np.int64).reshape(-1, 2),
        table([layer.reflection[1:] if layer.reflection else (0.0, 0.0) for layer in layers], 2),
        table([layer.highlight or none for layer in layers], 7),
        np.array([layer.surface.geometry.is_parallel for layer in layers], np.bool_),
        np.array([is_backdrop(layer.surface) for layer in layers], np.bool_),
    )


def visible_box(entry: AtlasEntry, reads: int, density: int) -> Box:
    """The box, in pixels, of the points whose look-ups read samples that are not transparent.

    A look-up reads `reads` samples on either side. Towards an edge with a visible sample, which repeats, it is endless.
    """
    margin = (reads + 1) / density  # one sample more for rounding
    is_visible = entry.opacity != 0
    limits = []
    for axis, start in ((0, entry.left), (1, entry.top)):
        index = np.flatnonzero(is_visible.any(axis=axis))
        if not index.size:
            return math.inf, math.inf, -math.inf, -math.inf
        first, last = int(index[0]), int(index[-1])
        low = -math.inf if first == 0 else (first + start) / density - margin
        high = math.inf if last == is_visible.shape[1 - axis] - 1 else (last + start) / density + margin
        limits.append((low, high))
    (left, right), (top, bottom) = limits
    return left, top, right, bottom


@inlined
def rays_of_row(p: float, q: float, slope: float, cell: float, y: int, picture: Floats) -> RayRow:
    """The rays through an aperture point to row y of a picture [3, H, W], in pixels from its centre."""
    x = slope * p - (picture.shape[2] - 1) / 2
    return RayRow(p, q, x, y + slope * q - (picture.shape[1] - 1) / 2, slope, cell)


@compiled
def visible_pixels(layers: RayLayers, k: int, row: RayRow, width: int) -> tuple[int, int]:
    """First pixel of a row at which a layer may be visible, and one past the last: its box, moved by D p."""
    near, far = layers.spans[k, 0], layers.spans[k, 1]
    left, top, right, bottom = layers.boxes[k, 0], layers.boxes[k, 1], layers.boxes[k, 2], layers.boxes[k, 3]
    # The row meets the layer at Y = y - D q, D anywhere in its span.
    high, low = row.y - min(near * row.q, far * row.q), row.y - max(near * row.q, far * row.q)
    if high < top or low > bottom:
        return 0, 0
    # Pixel x is at row.x + x: it meets the box where left <= row.x + x - D p <= right for some D.
    begin = left - row.x + min(near * row.p, far * row.p)
    stop = right - row.x + max(near * row.p, far * row.p) + 1
    return int(min(max(begin, 0.0), float(width))), int(min(max(np.ceil(stop), 0.0), float(width)))


@compiled
def intersect(layers: RayLayers, k: int, row: RayRow, begin: int, stop: int, at: Float64s) -> None:
    """Fill `at` [5, W] with X, Y, D and the derivatives of D along x and y, where rays meet layer k.

    On a plane, D = (d + a x + b y) / (1 + a p + b q). A dome is solved by Newton's method, starting from that plane
    plus the height of the bump at the pixel before: two or three steps then suffice.
    """
    form = layers.forms[k]
    disparity, a, b, bulge = form[0], form[1], form[2], form[3]
    radius, centre_x, centre_y = form[4], form[5], form[6]
    share = 1 / (1 + a * row.p + b * row.q)
    for x in range(begin, stop):
        at[2, x] = (disparity + a * (row.x + x) + b * row.y) * share
        at[3, x], at[4, x] = a * share, b * share
    if bulge != 0:
        height = 0.0
        for x in range(begin, stop):
            plane = at[2, x]
            D = plane + height
            # Newton's step of D - d(x - D p, y - D q), whose derivative is 1 + d_X p + d_Y q; d_X and d_Y are `slope_x`
            # and `slope_y`. It converges in a few steps, since `surfaces.STEEPEST` bounds the derivative.
            for _ in range(30):
                at_x, at_y = row.x + x - D * row.p, row.y - D * row.q
                offset_x, offset_y = (at_x - centre_x) / radius, (at_y - centre_y) / radius
                rise = max(1 - offset_x * offset_x - offset_y * offset_y, 0.0)
                steepness = -4 * bulge / radius * rise
                slope_x, slope_y = a + steepness * offset_x, b + steepness * offset_y
                share = 1 / (1 + slope_x * row.p + slope_y * row.q)
                step = (D - disparity - a * at_x - b * at_y - bulge * rise * rise) * share
                D -= step
                if abs(step) < 1e-10:
                    break
            at[2, x], at[3, x], at[4, x], height = D, slope_x * share, slope_y * share, D - plane
    for x in range(begin, stop):
        at[0, x] = row.x + x - at[2, x] * row.p
        at[1, x] = row.y - at[2, x] * row.q


@compiled
def add_highlight(layers: RayLayers, k: int, row: RayRow, begin: int, stop: int, at: Float64s, rgba: Floats) -> None:
    """Add the highlight of layer k to `rgba` [4, W] at the points that `intersect` found.

    Within a cell it moves by (e - drift) times the cell's width, e the relative slope, and is blurred by such a box.
    """
    lobe = layers.highlights[k]
    width, drift = lobe[3], lobe[4]
    centre_x, centre_y = lobe[5] + drift * row.p, lobe[6] + drift * row.q
    red, green, blue = rgba.dtype.type(lobe[0]), rgba.dtype.type(lobe[1]), rgba.dtype.type(lobe[2])
    for x in range(begin, stop):
        # The lobe and a box of width b = `spread`, whose variance is b^2 / 12; a wider lobe is lower.
        spread = (row.slope - at[2, x] - drift) * row.cell
        variance = width * width + spread * spread / 12
        exponent = ((at[0, x] - centre_x) ** 2 + (at[1, x] - centre_y) ** 2) / (2 * variance)
        # Beyond 20, the light is below exp(-20) = 2e-9 of its maximum, far below the rounding of float32.
        if exponent < 20.0:
            light = rgba.dtype.type(np.exp(-exponent) * width * width / variance) * rgba[3, x]
            rgba[0, x] += red * light
            rgba[1, x] += green * light
            rgba[2, x] += blue * light


@compiled
def composite_over(rgba: Floats, begin: int, stop: int, radiance: Floats) -> None:
    """Lay a layer, `rgba` [4, W], over `radiance` [3, W] from pixel `begin` to before `stop`."""
    # Colours are premultiplied by opacity: the layer adds them, and lets through 1 - opacity of what is behind it.
    one = rgba.dtype.type(1)
    for c in range(3):
        for x in range(begin, stop):
            radiance[c, x] = rgba[c, x] + (one - rgba[3, x]) * radiance[c, x]


@compiled
def composite_by_depth(rgba: Floats, disparities: Float64s, order: Integers, radiance: Floats) -> None:
    """Fill `radiance` [3, W] with layers [K, 4, W] in the order of their disparities [K, W]; `order` [K] is scratch."""
    one = rgba.dtype.type(1)
    for x in range(radiance.shape[1]):
        # Insertion sort of the layers that are not transparent: there are few, mostly in order already.
        count = 0
        for k in range(len(rgba)):
            if rgba[k, 3, x] != 0:
                place = count
                while place > 0 and disparities[order[place - 1], x] > disparities[k, x]:
                    order[place] = order[place - 1]
                    place -= 1
                order[place] = k
                count += 1
        red = green = blue = rgba.dtype.type(0)
        for place in range(count):
            k = order[place]
            passed = one - rgba[k, 3, x]
            red = rgba[k, 0, x] + passed * red
            green = rgba[k, 1, x] + passed * green
            blue = rgba[k, 2, x] + passed * blue
        radiance[0, x], radiance[1, x], radiance[2, x] = red, green, blue


@compiled
def composite_crossing(
    rgba: Floats, at: Float64s, crosses: Bools, row: RayRow, passed: Floats, radiance: Floats
) -> None:
    """Lay layers over one another as seen through a cell; their order may differ between parts of the cell.

    Where two surfaces cross, each is the nearer one in a part of the cell. The line where they cross moves over the
    picture by |e| times the cell's width. So the lead, the disparity of one minus that of the other, varies within the
    cell by `spread`: this distance times the gradient of the lead. The share of the cell in which a layer is the nearer
    one grows linearly from 0 to 1 as its lead goes from -spread / 2 to spread / 2. The light of a layer passes the
    shares of all other layers in front of it. `rgba` [K, 4, W] is 0 where a layer is not visible; `intersect` fills
    `at` [K, 5, W]; `passed` [W] is scratch.
    """
    radiance[:] = 0
    for k in range(len(rgba)):
        passed[:] = 1
        for m in range(len(rgba)):
            if m != k:
                _occlude(rgba[m, 3], at[m], at[k], m > k, crosses[m, k], row, passed)
        for c in range(3):
            for x in range(radiance.shape[1]):
                radiance[c, x] += passed[x] * rgba[k, c, x]


@compiled
def _occlude(
    opacity: Floats, front: Float64s, behind: Float64s, is_later: bool, crosses: bool, row: RayRow, passed: Floats
) -> None:
    """Multiply `passed` [W], the share of the light of one layer, by the share that another one lets through."""
    for x in range(passed.size):
        lead = front[2, x] - behind[2, x]
        # At equal disparities, the later layer is in front.
        before = 1.0 if lead > 0 or (lead == 0 and is_later) else 0.0
        if crosses:
            across, down = front[3, x] - behind[3, x], front[4, x] - behind[4, x]
            e = row.slope - (front[2, x] + behind[2, x]) / 2
            spread = abs(e) * row.cell * np.sqrt(across * across + down * down)
            before = min(max(0.5 + lead / spread, 0.0), 1.0) if abs(lead) < spread else before
        passed[x] *= 1 - passed.dtype.type(before) * opacity[x]
