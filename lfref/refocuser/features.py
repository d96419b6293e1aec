"""What a refiner reads of refocused planes: their pictures, other pictures of the same planes, and signs of errors.

All of it follows from the light field and the slopes, so any view grid and any number of planes serve. The features of
a plane at slope `s`, where `e` is the error scale of its picture `p`, `n` the noise in it, and `d` the disparity:

    fine middle coarse    p through filters of about 2, 5 and 9 pixels
    sum                   the plain sum of the views
    cells                 the sum of the views through cells
    central               the view at the angular centre
    everywhere            the picture by Wiener filters for all disparities of the scene
    local                 the sum of views through cells as wide as the plane is from the disparity of each pixel
    picture               p - 1/2
    inner                 the plain sum through the middle half of the aperture less that through all of it
    spread                standard deviation over the views of which the plain sum is the mean
    defocus               tanh(s - d) and tanh(0.3 |s - d|)
    relief                tanh of the range of d within squares of 9 and of 33 pixels
    coverage              share of the views that do not see the pixel, doubled
    fraction              distance of s from a whole slope, at which no view is read between its pixels, doubled
    views                 log2(number of views) / 3 - 2
    error_scale noise     log10(e) / 2 + 3/2, log10(n) / 2 + 3/2

The first eight are candidates: the refiner mixes its correction of their differences from `p`, as kernel-predicting
denoisers do (Bako et al., 2017). The candidates, `inner` and `spread` are in units of the error scale, which is

    e = hypot(mean of |o - p| over a square, n), or 0 where not all views see the pixel,

where `o` is `sum` or `cells`, whichever is nearer to `p`; if `p` is one of them, `o` is the other. Methods that blur
each surface by its own distance are nearly exact far from focus, more so than e tells: there, corrections of their
pictures fade out (`FADE`).
Letters: `N` planes, `K` channels of features, `C H W` channel, pixel row and column.
"""

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import noise_line
from lfref.functional.neighbours import binomial, box_max, box_mean
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.blockwise_wiener import blockwise_wiener, blockwise_wiener_parts
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.scene import Scene, analyze_scene
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocus.surface import per_pixel
from lfref.refocuser import filling
from lfref.refocuser.refocuser import Aperture, Operator, OperatorRefocuser

CANDIDATES = ("fine", "middle", "coarse", "sum", "cells", "central", "everywhere", "local")
FEATURES = (
    *CANDIDATES,
    *("picture", "inner", "spread", "defocus", "relief", "coverage", "fraction", "views", "error_scale", "noise"),
)
PLAIN_SUM = functools.partial(shift_and_sum, interpolation="cubic")
"""What `sum`, `inner` and `spread` are measured by."""

# The values below are those that the shipped network was trained with.
WINDOW = 5
"""Pixels along the side of the square over which differences are averaged."""
BLACK = 1e-6
"""Light added to error scale and noise before one divides by them or takes their logarithm."""
LIMIT = 3.0
"""Error scales that no candidate exceeds."""
ROUGHNESS = 1.57
"""Standard deviation of white noise divided by the mean absolute value of what `binomial` removes of it."""
RELIEF_WINDOWS = (9, 33)
"""Pixels along the sides of the squares in which the range of disparities is measured."""
FADE = (3.0, 4.5)
"""Distances of a plane from the disparities around a pixel, in pixels per view step: from the first one on, corrections
of methods that blur each surface by its own distance fade out; from the second one on there are none. On sim30 these
methods have 70 to 90 dB there, and corrections would cost up to 17 dB."""
BY_SURFACE: frozenset[Operator] = frozenset({refocus_by_layers, blockwise_wiener})
"""Methods that blur each surface by its own distance from the focus."""


class RefinerInputs(NamedTuple):
    """Arguments of a refiner."""

    features: Tensor
    """Features in the order of their names, [N, K, H, W]."""
    pictures: Tensor
    """Pictures to correct, in light, [N, C, H, W]."""
    error_scale: Tensor
    """Expected error of the pictures, in light, [N, 1, H, W]."""


def check_names(names: Sequence[str], n_candidates: int = 0) -> None:
    """Refuse unknown features, and a first `n_candidates` of them that are no candidates."""
    first = tuple(names)[:n_candidates]
    if not set(names) <= set(FEATURES) or len(first) < n_candidates or not set(first) <= set(CANDIDATES):
        expected = f"features must be among {', '.join(FEATURES)}, the first {n_candidates} of them candidates"
        raise InputError(expected, got=names, remedy=f"candidates are {', '.join(CANDIDATES)}")


def refiner_inputs(
    light: LightField,
    slopes: Tensor,
    base: OperatorRefocuser,
    names: Sequence[str] = FEATURES,
    n_at_once: int | None = None,
    dtype: torch.dtype = torch.float32,
    scene: Scene | None = None,
) -> Iterator[RefinerInputs]:
    """Refocus a light field by the method `base` at slopes [N], and compute what a refiner reads of the planes.

    Yields `n_at_once` consecutive planes in each part, or all; features of `names`, in this order, in `dtype`. `scene`
    is that of a light field without weights, if it is known.
    """
    check_names(names)
    views, weight = light.views, light.weight
    # Disparity and central view need every sample: those of little weight are replaced by what the other views show.
    whole = views if weight is None else filling.filled(views, weight.to(views))

    # Disparity of the central view, [H, W]: it is costly, and left out where nothing uses it.
    # (`disparities` of layers are not those of pixels.)
    takes_disparity = base.takes("disparities") and base.function is not refocus_by_layers
    disparity = whole.new_zeros(light.size)
    if max(light.grid) > 1 and (takes_disparity or {"central", "defocus", "relief", "local"} & {*names}):
        scene = scene or analyze_scene(whole)
        disparity = scene.refined_disparity.to(whole)
    rows, columns = (slice((n_views - 1) // 2, n_views // 2 + 1) for n_views in light.grid)
    middle_views = whole[rows, columns].clone()
    del whole  # it is as large as the views
    if takes_disparity:
        base = replace(base, operator=functools.partial(base.operator, disparities=disparity))

    def refocused(images: Tensor, operator: Operator, aperture: Aperture | None = base.aperture) -> Tensor:
        method = OperatorRefocuser("a feature", operator, aperture)
        method = method.of_scene(scene) if scene is not None and weight is None and images is views else method
        return method.stack(images, weight, slopes, light.positions)

    # Of all planes: the pictures, other ways to make them, and the features that compare the views.
    others, is_single = {}, max(light.grid) == 1  # of which all pictures are that view
    if "everywhere" in names and base.function is blockwise_wiener and not is_single:
        # It makes its picture of this one.
        parts = refocused(views, functools.partial(blockwise_wiener_parts, **base.options))
        pictures, others["everywhere"] = parts.tensor_split(2, 1)
    else:
        known = base if scene is None or weight is not None else base.of_scene(scene)
        pictures = known.stack(views, weight, slopes, light.positions)
        if "everywhere" in names:
            others["everywhere"] = pictures if is_single else refocused(views, separable_wiener)
    if "local" in names:
        by_disparity = functools.partial(shift_and_sum, interpolation="cubic", fill_factor=1.0, disparity=disparity)
        others["local"] = refocused(views, by_disparity)
    sums, cells = refocused(views, PLAIN_SUM), refocused(views, shift_and_sum_antialiased)
    grey, grey_sums = views.mean(2, keepdim=True), sums.mean(1, keepdim=True)
    spread = (refocused(grey.square(), PLAIN_SUM) - grey_sums.square()).clamp(min=0).sqrt()
    inner = refocused(grey, PLAIN_SUM, lambda grid: apertures.square(grid, min(grid) / 2)) - grey_sums
    covered = coverage(slopes, views)
    fraction = 2 * (slopes - slopes.round()).abs().to(views)[:, None, None, None]

    # Of the light field: central view, range of disparities, and variance of the noise, shot * light + read.
    # The view at the angular centre, [C, H, W]; of even grids, the mean of the middle ones at the disparity.
    is_single = middle_views.shape[:2].numel() == 1
    central = middle_views[0, 0] if is_single else per_pixel(middle_views, disparity, "cubic", border="edge")[0]
    depth = disparity[None, None]
    ranges = [(-box_max(-depth, window), box_max(depth, window)) for window in RELIEF_WINDOWS]
    relief = torch.cat([high - low for low, high in ranges], 1).tanh()
    shot, read = noise_line.measure(light)
    aperture = views.new_ones(light.grid) if base.aperture is None else base.aperture(light.grid)
    n_views = float(aperture.sum().square() / aperture.square().sum())  # equal views that average noise as much

    # A method that is one of the two sums is measured by the other.
    measures = [stack for stack in (sums, cells) if not torch.equal(pictures, stack)] or [sums, cells]

    n_at_once = n_at_once or len(slopes)
    for first in range(0, len(slopes), n_at_once):
        part = slice(first, first + n_at_once)
        picture = pictures[part]
        fine = binomial(picture)
        middle = binomial(fine, 2)
        coarse = binomial(middle, 4)

        # Noise that the views leave in the picture: what the line says, but never more than is rough about the picture,
        # nor than the views differ by. (Grey views differ less: noise of its own in each of C channels is sqrt(C) times
        # as large.)
        noise = ((shot * picture.mean(1, keepdim=True).clamp(min=0) + read) / n_views).sqrt()
        roughness = ROUGHNESS * box_mean((picture - fine).abs().mean(1, keepdim=True), WINDOW)
        deviation = math.sqrt(views.shape[2] / n_views) * box_mean(spread[part], WINDOW)
        noise = noise.minimum(roughness).minimum(deviation)

        nearer = functools.reduce(torch.minimum, [(other[part] - picture).abs() for other in measures])
        error_scale = box_mean(nearer.mean(1, keepdim=True), WINDOW).hypot(noise)
        # Nothing can be known where a view is missing: at 0 the picture stays as it is.
        error_scale = error_scale * (covered[part] > 0.999)  # 1, but for rounding

        unit = error_scale + BLACK
        focus = slopes[part].to(disparity)[:, None, None, None]
        defocus = focus - disparity
        one = torch.ones_like(error_scale)
        features = {
            "fine": candidate(fine, picture, unit),
            "middle": candidate(middle, picture, unit),
            "coarse": candidate(coarse, picture, unit),
            "sum": candidate(sums[part], picture, unit),
            "cells": candidate(cells[part], picture, unit),
            "central": candidate(central, picture, unit),
            **{name: candidate(stack[part], picture, unit) for name, stack in others.items()},
            "picture": picture - 0.5,
            "inner": compressed(inner[part], unit) / 3,
            "spread": compressed(spread[part], unit) / 3,
            "defocus": torch.cat([defocus.tanh(), (0.3 * defocus.abs()).tanh()], 1),
            "relief": relief.expand(len(picture), -1, -1, -1),
            "coverage": 2 * (1 - covered[part]),
            "fraction": fraction[part] * one,
            "views": (math.log2(math.prod(light.grid)) / 3 - 2) * one,
            "error_scale": unit.log10() / 2 + 1.5,
            "noise": (noise + BLACK).log10() / 2 + 1.5,
        }
        if base.function in BY_SURFACE:
            low, high = ranges[-1]
            distance = torch.maximum(low - focus, focus - high)
            error_scale = error_scale * ((FADE[1] - distance) / (FADE[1] - FADE[0])).clamp(0, 1)
        yield RefinerInputs(torch.cat([features[name].to(dtype) for name in names], 1), picture, error_scale)


def candidate(other: Tensor, picture: Tensor, unit: Tensor) -> Tensor:
    """Difference of another picture from the picture in units of the error scale, limited smoothly to `LIMIT`."""
    difference = other - picture
    return difference / (unit + difference.abs() / LIMIT)


def compressed(difference: Tensor, unit: Tensor) -> Tensor:
    """asinh of a difference in units of the error scale, so that clean and noisy scenes look alike."""
    ratio = difference / unit
    # torch.asinh takes ten times as long.
    return (ratio.abs() + (ratio.square() + 1).sqrt()).log().copysign(ratio)


def coverage(slopes: Tensor, views: Tensor) -> Tensor:
    """Share of the views within whose frame a pixel of a plane lies, [N, 1, H, W]."""
    shares = []
    for n_views, n_pixels in ((views.shape[0], views.shape[3]), (views.shape[1], views.shape[4])):
        offsets = geometry.angular_offsets(n_views).to(slopes)
        at = torch.arange(n_pixels).to(slopes) + (slopes[:, None] * offsets)[..., None]
        # A sample between the outermost pixel and the next one beyond still reads the outermost.
        shares.append(((at > -1) & (at < n_pixels)).to(views).mean(1))
    rows, columns = shares
    return rows[:, None, :, None] * columns[:, None, None, :]
