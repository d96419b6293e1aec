"""The sheet of `lfref info`: central view, disparity, corner views, and light of each view."""

import itertools

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lfref.captures.inspect import Inspection
from lfref.lightfield import LightField
from lfref.report import drawing, pictures, tables
from lfref.report.refocused import brightening


def inspection_sheet(inspection: Inspection) -> Figure:
    """The central view, its disparities as a map and a histogram, the corner views, and the light of all views."""
    height, width = inspection.field.size
    # Two pictures of one shape stand side by side, above a row of a fixed height.
    top = min(max(4.9 * height / width, 1.2), 7.0)  # inches
    figure = drawing.new_figure(11, top + 3.2)
    rows, columns = inspection.field.grid
    title = f"{inspection.field.name}: {rows}x{columns} views of {height}x{width}"
    figure.suptitle(tables.plot_text(title, 120), fontsize=11, x=0.01, ha="left")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(top + 0.3, 2.9))[:, 0]
    centre, disparity = above.subplots(1, 2)
    gain = brightening(inspection.field)
    _draw_view(centre, inspection, inspection.reference, gain)
    values, confidence = (values.cpu().numpy() for values in (inspection.disparity, inspection.confidence))
    low, high = inspection.slopes or (float(values.min()), float(values.max()))
    disparity.imshow(pictures.greyed(pictures.coloured(values, low, high), confidence))
    disparity.set_title(f"disparity, {low:.3g} (dark) to {high:.3g} px per view step; grey: unknown", fontsize=9)
    disparity.set_axis_off()
    corners, light, slopes = below.subfigures(1, 3, squeeze=False, width_ratios=(1.35, 1, 1.5))[0]
    v_ends, u_ends = (sorted({0, n - 1}) for n in (rows, columns))
    grid = corners.subplots(len(v_ends), len(u_ends), squeeze=False)
    for axes, view in zip(grid.flat, itertools.product(v_ends, u_ends), strict=True):
        _draw_view(axes, inspection, view, gain)
    _draw_light(light.subplots(), inspection.field, inspection.reference)
    _draw_slopes(slopes.subplots(), inspection)
    return figure


def _draw_view(axes: Axes, inspection: Inspection, view: tuple[int, int], gain: float) -> None:
    field = inspection.field
    axes.imshow(pictures.for_display(field.views[view].clamp(0, None), gain, field.picture_encoding))
    axes.set_title(f"view {view[0]}, {view[1]}", fontsize=9)
    axes.set_axis_off()


def _draw_light(axes: Axes, field: LightField, reference: tuple[int, int]) -> None:
    # Every fourth pixel is enough for a mean.
    samples = field.views[..., ::4, ::4].float().nan_to_num(0, 0, 0)
    weight = torch.ones_like(samples) if field.weight is None else field.weight[..., ::4, ::4].expand_as(samples)
    light = (samples * weight).sum((2, 3, 4)) / weight.sum((2, 3, 4))  # NaN where a view has no weight
    relative = (light / light[reference].clamp(min=1e-6)).cpu().numpy()
    # Black is 0.8 of the central view, unless views are darker: small differences show, and do not look large.
    ends = min(0.8, float(np.nanmin(relative))), max(1.0, float(np.nanmax(relative)))
    shown = axes.imshow(relative, cmap="gray", vmin=ends[0], vmax=ends[1])
    axes.figure.colorbar(shown, ax=axes, pad=0.03, shrink=0.8)
    axes.set_title("light of each view, central: 1", fontsize=9)
    yticks, xticks = (sorted({0, n // 2, n - 1}) for n in field.grid)
    axes.set(xlabel="view column", ylabel="view row", xticks=xticks, yticks=yticks)


def _draw_slopes(axes: Axes, inspection: Inspection) -> None:
    sure = inspection.disparity[inspection.confidence > 0.5].flatten().cpu().numpy()
    drawing.style_axes(axes, "slope, px per view step", "share of confident pixels", "")
    if inspection.slopes is None or not sure.size:
        axes.set_title("too little parallax to measure", fontsize=9, loc="left")
        return
    (low, high), planes = inspection.slopes, inspection.planes.values
    margin = max(0.15 * (high - low), 0.05)
    shares = np.full(sure.size, 1 / sure.size)
    axes.hist(sure, bins=80, range=(low - margin, high + margin), weights=shares, color=drawing.BLUE)
    axes.axvspan(low, high, color=drawing.ORANGE, alpha=0.12)
    axes.plot(planes, [0] * len(planes), "^", color=drawing.BLACK, markersize=4, clip_on=False)
    axes.set_title(f"range {low:.3g} to {high:.3g} (shaded); \N{BLACK UP-POINTING TRIANGLE} planes=auto", fontsize=9)
