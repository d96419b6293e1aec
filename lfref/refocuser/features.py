"""What a refiner reads of refocused planes: the pictures, candidates for them, and features that tell where they err.

Everything is made of the light field and the slopes alone, so any view grid and any number of planes serve. Candidates
are other pictures of the same plane; the refiner mixes its correction of their differences from the picture, in units
of the error scale, as in kernel-predicting denoisers (Bako et al., 2017).
Letters: `N` planes, `C H W` channel, pixel row and column, `K` channels of features, `s` slope, `d` disparity.
"""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import noise_line
from lfref.functional.neighbours import binomial, box_max, box_mean
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.disparity.disparity_map import coarse_disparity
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells
from lfref.refocus.surface import per_pixel
from lfref.refocuser import filling
from lfref.refocuser.operators import OperatorRefocuser

CANDIDATES = ("fine", "middle", "coarse", "sum", "cells", "central")
"""Features that are other pictures of the plane: the picture smoothed, sums of the views, the central view."""
FEATURES = (
    *CANDIDATES,
    *("picture", "inner", "spread", "defocus", "relief", "coverage", "fraction", "views", "error_scale", "noise"),
)
"""Names of all features; `refiner_inputs` says what each is."""
FORMER_NAMES = {
    "guides": "features",
    "doubts": "error_scale",
    "doubt": "error_scale",
    "chance": "noise",
    "n_guides": "n_features",
    "n_offers": "n_candidates",
}
"""Old -> new names, of features and of entries of files that earlier versions wrote."""
POINTS = functools.partial(shift_and_sum, interpolation="cubic")
"""The plain sum of the views, which spread and inner are measured by."""

# The values below are those that the shipped network was trained with.
WINDOW = 5
"""Pixels along the side of the square over which differences are averaged."""
BLACK = 1e-6
"""Light added to the error scale before it divides."""
LIMIT = 3.0
"""Error scales that no candidate exceeds."""
ROUGHNESS = 1.57
"""Standard deviation of white noise divided by the mean absolute value of what `binomial` removes of it."""
RELIEF_WINDOWS = (9, 33)
"""Pixels along the sides of the squares in which the range of disparities is measured."""


class RefinerInputs(NamedTuple):
    """What a refiner is called with."""

    features: Tensor
    """One after the other in the order of the names, [N, K, H, W]."""
    pictures: Tensor
    """What is corrected, in light, [N, C, H, W]."""
    error_scale: Tensor
    """How far the pictures may be off, in light, [N, 1, H, W]."""


def renamed(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry of a file with today's names for its keys, and for the names of features that it lists."""
    made = {FORMER_NAMES.get(key, key): value for key, value in entry.items()}
    if isinstance(made.get("features"), list | tuple):
        made["features"] = [FORMER_NAMES.get(name, name) for name in made["features"]]
    return made


def check_names(names: Sequence[str], n_candidates: int = 0) -> None:
    """Refuse unknown features, and features of which no correction can be mixed.

    Args:
        names: Of features.
        n_candidates: How many of them the refiner takes for candidates: the first ones.

    Raises:
        InputError: A name is not in `FEATURES`, or one of the first is not in `CANDIDATES`.
    """
    if unknown := [name for name in names if name not in FEATURES]:
        raise InputError(f"features must be among {', '.join(FEATURES)}", got=", ".join(map(str, unknown)))
    first = tuple(names)[:n_candidates]
    if len(first) < n_candidates or not set(first) <= set(CANDIDATES):
        remedy = "order the features of the recipe, or set net.n_candidates"
        raise InputError(
            f"the first {n_candidates} features must be among {', '.join(CANDIDATES)}", got=first, remedy=remedy
        )


def refiner_inputs(
    light: LightField,
    slopes: Tensor,
    base: OperatorRefocuser,
    names: Sequence[str] = FEATURES,
    n_at_once: int | None = None,
    dtype: torch.dtype = torch.float32,
) -> Iterator[RefinerInputs]:
    """Refocus a light field by a classical method, and compute what a refiner reads of the planes.

    Args:
        light: Floating point.
        slopes: In pixels per view step, float64, [N].
        base: The method that makes the pictures; the aperture it looks through counts for the features too.
        names: Of `FEATURES`, in the order in which the refiner reads them.
        n_at_once: Planes in each part; None: all.
        dtype: Of the features.

    Yields:
        Consecutive planes, `n_at_once` in each part but the last.

    Raises:
        InputError: There is no such feature.
    """
    check_names(names)
    # 1. The views without gaps: samples of little weight replaced by what the other views show.
    views, weight, positions = light.views, light.weight, light.positions
    whole = views if weight is None else filling.filled(views, weight.to(views))

    # 2. Coarse disparity of the central view, [H, W]. It is costly: left out where nothing uses it.
    takes_disparity = base.takes("disparities")
    disparity = whole.new_zeros(light.size)
    if max(light.grid) > 1 and (takes_disparity or {"central", "defocus", "relief"} & {*names}):
        disparity = coarse_disparity(whole).to(whole)
    if takes_disparity:
        base = replace(base, operator=functools.partial(base.operator, disparities=disparity))

    # 3. The pictures, and two other ways to make them: the plain sum, and the sum through cells.
    pictures = base.stack(views, weight, slopes, positions)
    points = OperatorRefocuser("points", POINTS, base.aperture)
    sums = points.stack(views, weight, slopes, positions)
    through_cells = OperatorRefocuser("cells", shift_and_sum_through_cells, base.aperture)
    cells = through_cells.stack(views, weight, slopes, positions)

    # 4. Standard deviation over the views that a pixel is the sum of, and what the middle of the aperture, half as
    # wide, shows more than all of it: both of grey views, [N, 1, H, W].
    grey, grey_sums = views.mean(2, keepdim=True), sums.mean(1, keepdim=True)
    squares = points.stack(grey.square(), weight, slopes, positions)
    spread = (squares - grey_sums.square()).clamp(min=0).sqrt()
    half = OperatorRefocuser("half", POINTS, lambda grid: apertures.square(grid, min(grid) / 2))
    inner = half.stack(grey, weight, slopes, positions) - grey_sums

    # 5. What the light field says of all planes: noise, range of the disparities, frame of the views, central view.
    shot, read = noise_line.measure(light)
    aperture = views.new_ones(light.grid) if base.aperture is None else base.aperture(light.grid)
    n_views = float(aperture.sum().square() / aperture.square().sum())  # equal views that average noise as much
    depth = disparity[None, None]
    relief = torch.cat([box_max(depth, window) + box_max(-depth, window) for window in RELIEF_WINDOWS], 1).tanh()
    covered = coverage(slopes, views)
    central = _central_view(whole, disparity)
    # How far each slope is from a whole one, at which no view is read between its pixels, 0 to 1.
    fraction = 2 * (slopes - slopes.round()).abs().to(views)[:, None, None, None]

    # A method that is one of the two sums is measured by the other.
    others = [stack for stack in (sums, cells) if not torch.equal(pictures, stack)] or [sums, cells]

    for planes in torch.arange(len(slopes)).split(n_at_once or len(slopes)):
        part = slice(int(planes[0]), int(planes[-1]) + 1)
        picture = pictures[part]
        # 6. The picture through wider and wider filters, of about 2, 5 and 9 pixels.
        fine = binomial(picture)
        middle = binomial(fine, 2)
        coarse = binomial(middle, 4)

        # 7. Standard deviation that the noise of the views leaves in the picture: never more than is rough about the
        # picture, nor than the views differ by. (The spread is that of grey views: noise of its own in each of C
        # channels is sqrt(C) times as large.)
        noise = ((shot * picture.mean(1, keepdim=True).clamp(min=0) + read) / n_views).sqrt()
        roughness = ROUGHNESS * box_mean((picture - fine).abs().mean(1, keepdim=True), WINDOW)
        deviation = math.sqrt(views.shape[2] / n_views) * box_mean(spread[part], WINDOW)
        noise = noise.minimum(roughness).minimum(deviation)

        # 8. The error scale: the noise, and the distance to the nearer one of the other pictures. Where not all views
        # see a pixel nothing can be known: the scale is 0, and the picture stays as it is.
        nearer = functools.reduce(torch.minimum, [(other[part] - picture).abs() for other in others])
        error_scale = box_mean(nearer.mean(1, keepdim=True), WINDOW).hypot(noise)
        error_scale = error_scale * (covered[part] > 0.999)  # 1, but for rounding
        unit = error_scale + BLACK

        # 9. The features, each of the order of 1.
        defocus = slopes[part].to(disparity)[:, None, None, None] - disparity
        one = torch.ones_like(error_scale)
        features = {
            "fine": candidate(fine, picture, unit),
            "middle": candidate(middle, picture, unit),
            "coarse": candidate(coarse, picture, unit),
            "sum": candidate(sums[part], picture, unit),
            "cells": candidate(cells[part], picture, unit),
            "central": candidate(central, picture, unit),
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
        yield RefinerInputs(torch.cat([features[name].to(dtype) for name in names], 1), picture, error_scale)


def candidate(other: Tensor, picture: Tensor, unit: Tensor) -> Tensor:
    """Difference of another picture from the picture in units of the error scale, limited smoothly to `LIMIT`."""
    difference = other - picture
    return difference / (unit + difference.abs() / LIMIT)


def compressed(difference: Tensor, unit: Tensor) -> Tensor:
    """asinh of a difference in units of the error scale: clean and noisy scenes look alike, large ones grow slowly."""
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


def _central_view(whole: Tensor, disparity: Tensor) -> Tensor:
    """The view at the angular centre, [C, H, W]; of even grids, the mean of those around it at each pixel's slope."""
    rows, columns = (slice((n_views - 1) // 2, n_views // 2 + 1) for n_views in whole.shape[:2])
    middle = whole[rows, columns]
    if middle.shape[:2].numel() == 1:
        return middle[0, 0]
    return per_pixel(middle, disparity, "cubic", border="edge")[0]
