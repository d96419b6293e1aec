"""One sheet about a light field: what it shows, how far away that is, and how bright each view is."""

from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from lfref.captures.inspect import Inspection
from lfref.lightfield import LightField
from lfref.report import drawing, pictures, tables

WIDTH = 11.0  # inches
BINS = 80
BEYOND = 0.15  # of the range, shown of the histogram at either end
LEAST_RANGE = 0.01  # of the colours, in pixels per view step
LEAST_LIGHT = 0.8  # of the central view's: where the scale of grey starts, unless views are darker
SURE = 0.5  # confidence of what the histogram counts
STRIDE = 4  # pixels: brightness of a view needs no more


def inspection_sheet(seen: Inspection) -> Figure:
    """The central view, its disparities as a map and a histogram, the corner views, and the light of all views.

    Args:
        seen: What was found.
    """
    height, width = seen.field.size
    # Beside each other two pictures of one shape; below them a row of a fixed height.
    top = min(max((WIDTH / 2 - 0.6) * height / width, 1.2), 7.0)
    figure = drawing.new_figure(WIDTH, top + 3.2)
    figure.suptitle(tables.drawable(_title(seen), 120), fontsize=11, x=0.01, ha="left")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(top + 0.3, 2.9))[:, 0]
    centre, disparity = above.subplots(1, 2)
    _draw_view(centre, seen, seen.evidence.reference, "view {}, {}")
    _draw_disparity(disparity, seen)
    corners, light, slopes = below.subfigures(1, 3, squeeze=False, width_ratios=(1.35, 1, 1.5))[0]
    _draw_corners(corners, seen)
    _draw_light(light.subplots(), seen.field, seen.evidence.reference)
    _draw_slopes(slopes.subplots(), seen)
    return figure


def _title(seen: Inspection) -> str:
    rows, columns = seen.field.grid
    height, width = seen.field.size
    return f"{seen.field.name}: {rows}x{columns} views of {height}x{width}"


def _exposure(seen: Inspection) -> float:
    """One gain for all views; dark captures are brightened."""
    return max(1.0, pictures.common_exposure(seen.field.views[seen.evidence.reference].nan_to_num()))


def _draw_view(axes: Axes, seen: Inspection, place: tuple[int, int], title: str) -> None:
    axes.imshow(pictures.for_display(seen.field.views[place].clamp(0, None), _exposure(seen)))
    axes.set_title(title.format(*place), fontsize=9)
    axes.set_axis_off()


def _draw_disparity(axes: Axes, seen: Inspection) -> None:
    values, opacity = (each.cpu().numpy() for each in (seen.disparity, seen.confidence))
    low, high = seen.slopes or (float(values.min()), float(values.max()))
    look: dict[str, Any] = {"cmap": drawing.MAP, "vmin": low, "vmax": max(high, low + LEAST_RANGE)}
    # Drawn twice, the first time invisibly: a colour bar of a half transparent picture would be pale too.
    shown = axes.imshow(values, alpha=0 * opacity, **look)
    bar = axes.figure.colorbar(shown, ax=axes, pad=0.02)
    if bar.solids is not None:
        bar.solids.set_alpha(1)
    axes.imshow(values, alpha=opacity.clip(0, 1), **look)
    axes.set_title("disparity, px per view step; pale: unsure", fontsize=9)
    axes.set_axis_off()


def _draw_corners(figure: SubFigure, seen: Inspection) -> None:
    rows, columns = (sorted({0, n - 1}) for n in seen.field.grid)
    grid = figure.subplots(len(rows), len(columns), squeeze=False)
    for axes, place in zip(grid.flat, [(v, u) for v in rows for u in columns], strict=True):
        _draw_view(axes, seen, place, "view {}, {}")


def _draw_light(axes: Axes, field: LightField, reference: tuple[int, int]) -> None:
    light = field.views[..., ::STRIDE, ::STRIDE].float().nan_to_num(0, 0, 0).mean((2, 3, 4))
    if field.weight is not None:
        light = torch.where(field.weight[..., ::STRIDE, ::STRIDE].amax((2, 3, 4)) > 0, light, torch.nan)
    relative = (light / light[reference].clamp(min=1e-6)).cpu().numpy()
    ends = min(LEAST_LIGHT, float(np.nanmin(relative))), max(1.0, float(np.nanmax(relative)))
    shown = axes.imshow(relative, cmap="gray", vmin=ends[0], vmax=ends[1])
    axes.figure.colorbar(shown, ax=axes, pad=0.03, shrink=0.8)
    axes.set_title("light of each view, central: 1", fontsize=9)
    axes.set(xlabel="view column", ylabel="view row", xticks=_ends(field.grid[1]), yticks=_ends(field.grid[0]))


def _ends(n: int) -> list[int]:
    return sorted({0, n // 2, n - 1})


def _draw_slopes(axes: Axes, seen: Inspection) -> None:
    sure = seen.disparity[seen.confidence > SURE].flatten().cpu().numpy()
    drawing.calm(axes, "slope, px per view step", "share of what is sure", "")
    if seen.slopes is None or not sure.size:
        axes.set_title("too little is seen to move", fontsize=9, loc="left")
        return
    low, high = seen.slopes
    margin = max(BEYOND * (high - low), 0.05)
    shares = np.full(sure.size, 1 / sure.size)
    axes.hist(sure, bins=BINS, range=(low - margin, high + margin), weights=shares, color=drawing.BLUE)
    axes.axvspan(low, high, color=drawing.ORANGE, alpha=0.12)
    for end in (low, high):
        axes.axvline(end, color=drawing.ORANGE, linewidth=1.2)
    axes.plot(seen.planes.values, [0] * len(seen.planes), "^", color=drawing.BLACK, markersize=4, clip_on=False)
    axes.set_xlim(min(low - margin, *seen.planes.values), max(high + margin, *seen.planes.values))
    axes.set_title(f"range {low:.3g} to {high:.3g} (shaded); \N{BLACK UP-POINTING TRIANGLE} planes=auto", fontsize=9)
