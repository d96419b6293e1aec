"""Draw the pictures of the pages from simulated scenes. Run by `make figures`.

Letters: `s` slope in pixels per view step, `x y` pixel column and row.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import against_mitsuba
import against_truth
import browsing
import effects
import hard_cases
import numpy as np
import paper_pictures
import scenes
import sheets
import simulator_pictures
import torch
from matplotlib.figure import Figure
from torch import Tensor
from torch.nn import functional as F

import lfref
from lfref import geometry
from lfref.refocus import apertures
from lfref.refocus.focus.all_in_focus import index_to_slope
from lfref.refocus.shift.shift_and_sum import coverage
from lfref.report import drawing, pictures, tables

ROOT = Path(__file__).resolve().parents[1]
DEPTH: dict[str, Any] = {"cmap": "viridis", "vmin": scenes.FAR, "vmax": scenes.NEAR}
ALPHA = tables.heading("alpha")
SLOPE_LABEL = "slope, px per view step"


def alpha() -> Figure:
    """The two meanings of alpha, with the planes of the paper as dots."""
    figure = drawing.new_figure(sheets.WIDTH, 2.5)
    line, paper = np.linspace(0.117, 2.05, 400), [step / 8 for step in range(1, 17)]
    titles = {"the paper's 16 planes": (-7.6, 1.5), "near the captured focus": (-1.1, 1.1)}
    for axes, (title, limits) in zip(figure.subplots(1, 2), titles.items(), strict=True):
        for convention, label, colour in (
            ("ng", f"ng: s = 1 \N{MINUS SIGN} 1/{ALPHA}", drawing.BLUE),
            ("parallel", f"parallel: s = {ALPHA} \N{MINUS SIGN} 1", drawing.RED),
        ):
            axes.plot(line, geometry.slopes(line, convention), color=colour, linewidth=1.4)
            axes.plot(paper, geometry.slopes(paper, convention), "o", color=colour, markersize=3.5, label=label)
        sheets.label(axes, ALPHA, SLOPE_LABEL, title)
        axes.set_ylim(limits)
    axes.legend(frameon=False, fontsize=8)
    return figure


def shift_and_sum() -> Figure:
    """The still life, focused far, in the middle and near."""
    views, _ = scenes.still_life()
    slopes = [scenes.FAR, scenes.MIDDLE, scenes.NEAR]
    return sheets.sheet(zip(map(sheets.at, slopes), lfref.shift_and_sum(views, slopes), strict=True))


def interpolation() -> Figure:
    """A wall in focus at half-pixel shifts by each interpolation, and what each does wrong."""
    views, slope = scenes.wall(0.5), [0.5]
    exact = lfref.exact_fourier(views, slope)[0]
    window = (..., slice(64, 112), slice(68, 140))
    names = ("nearest", "linear", "cubic", "exact")
    shown = [(name, lfref.shift_and_sum(views, slope, interpolation=name)[0][window]) for name in names]
    errors = [sheets.error("error, PSNR ", image, exact[window]) for _, image in shown]
    return sheets.sheet([*shown, *errors], 4, bar="absolute error", **sheets.ERROR)


def borders() -> Figure:
    """A corner of a wall in focus at a large slope, under the four border rules."""
    views, slope = scenes.wall(8.0), [8.0]
    window = (..., slice(0, 56), slice(0, 72))
    names = ("renormalize", "edge", "zero", "wrap")
    corners = [(name, lfref.shift_and_sum(views, slope, border=name)[0][window]) for name in names]
    share = coverage(slope, scenes.GRID, scenes.SIZE)[0][window]
    return sheets.sheet([*corners, ("coverage", share)], 5, bar="share of views", **sheets.SHARE)


def exact_fourier() -> Figure:
    """The reference, and how far shift-and-sum is from it under two border rules."""
    views, _ = scenes.still_life()
    exact = lfref.exact_fourier(views, [scenes.NEAR])[0]
    cells = [(f"exact_fourier\n{sheets.at(scenes.NEAR)}", exact)]
    for name in ("wrap", "renormalize"):
        image = lfref.shift_and_sum(views, [scenes.NEAR], interpolation="exact", border=name)[0]
        cells.append(sheets.error(f"against exact shift_and_sum,\nborder {name}: ", image, exact))
    return sheets.sheet(cells, bar="absolute difference", **sheets.ERROR)


def fourier_slice() -> Figure:
    """Errors of Fourier slices against the reference, by kernel and padding."""
    views, _ = scenes.still_life()
    exact = lfref.exact_fourier(views, [scenes.NEAR])[0]
    settings: tuple[tuple[str, dict[str, Any]], ...] = (
        ("linear,\nnot padded: ", {"kernel": "linear", "padding": 1}),
        ("linear,\npadded twice: ", {"kernel": "linear", "padding": 2}),
        ("Kaiser-Bessel, 4 bins,\npadded twice: ", {"width": 4}),
        ("Kaiser-Bessel, 6 bins,\npadded twice: ", {"width": 6}),
    )
    cells = [
        sheets.error(name, lfref.fourier_slice(views, [scenes.NEAR], **options)[0], exact) for name, options in settings
    ]
    return sheets.sheet(cells, 4, bar="absolute error", **sheets.ERROR)


def focal_stack_transform() -> Figure:
    """Five planes of a stack, and a cut through all 61 of them along one row of pixels."""
    views, _ = scenes.still_life()
    slopes, row = geometry.even_slopes(61, -1.5, 1.5).tolist(), 132
    stack = lfref.focal_stack_transform(views, 61, -1.5, 1.5)
    figure = drawing.new_figure(sheets.WIDTH, 3.0)
    grid = figure.add_gridspec(2, 5, height_ratios=(1, 2.3))
    for column, plane in enumerate((14, 23, 32, 40, 48)):
        axes = figure.add_subplot(grid[0, column])
        sheets.show(axes, sheets.at(slopes[plane]), stack[plane])
        axes.axhline(row, color="white", linewidth=0.7, linestyle=":")
    axes = figure.add_subplot(grid[1, :])
    cut = pictures.for_display(stack[:, :, row].movedim(0, 1))
    axes.imshow(cut, extent=(-0.5, scenes.SIZE[1] - 0.5, -1.525, 1.525), origin="lower", aspect="auto")
    sheets.label(axes, "x along the dotted row, px", SLOPE_LABEL)
    axes.grid(visible=False)
    return figure


def tilt_shift() -> Figure:
    """A slanted page: one slope for the picture, and a slope that changes from top to bottom."""
    views = scenes.slanted_page()
    flat = lfref.shift_and_sum(views, [0.0])[0]
    return sheets.sheet(
        [("one view", views[3, 3]), ("shift_and_sum, s = 0", flat), ("tilt_shift", _along_the_page(views))]
    )


def per_pixel() -> Figure:
    """Noisy views averaged along a map of slopes."""
    views, truth = scenes.still_life()
    noisy = views + 0.12 * torch.randn(views.shape, generator=torch.Generator().manual_seed(0))
    refocused = lfref.per_pixel(noisy, truth, interpolation="cubic")[0]
    cells = [("one of 49 noisy views", noisy[3, 3]), ("per_pixel", refocused), ("slope_map", truth)]
    return sheets.sheet(cells, bar=SLOPE_LABEL, **DEPTH)


def homography() -> Figure:
    """The page again, seen by cameras that look anyhow."""
    views, cameras = scenes.turned(scenes.slanted_page())
    matrices = scenes.plane_homographies(cameras, scenes.pinhole(), scenes.page_plane())
    refocused = lfref.homography(views, matrices)[0]
    return sheets.sheet([("one view", views[1, 5]), ("tilt_shift", _along_the_page(views)), ("homography", refocused)])


def all_in_focus() -> Figure:
    """The still life, sharp throughout, and the slope at which each pixel is sharpest."""
    views, truth = scenes.still_life()
    slopes = geometry.even_slopes(17, -1.2, 1.2)
    image, index, confidence = lfref.all_in_focus(lfref.exact_fourier(views, slopes))
    slope_map = index_to_slope(index, slopes)
    pair = [("image", image), ("confidence, white: 1", confidence[None])]
    return sheets.sheet([*pair, ("index, as slope", slope_map), ("true disparity", truth)], 2, bar=SLOPE_LABEL, **DEPTH)


def super_resolve() -> Figure:
    """Small print in a view, refocused and enlarged, and super-resolved."""
    slope = [0.25]
    views, truth = scenes.small_print(slope[0])
    sharper = lfref.super_resolve(views, slope, factor=2)[0]
    mean = lfref.shift_and_sum(views, slope, interpolation="exact")[0]
    inner = (..., slice(6, -6), slice(6, -6))
    names = ("one view, bicubic", "shift_and_sum, bicubic", "super_resolve")
    inside = [image[inner] for image in (_enlarged(views[3, 3]), _enlarged(mean), sharper)]
    return sheets.sheet(
        (f"{name}: {sheets.decibels(image, truth[inner])}", image) for name, image in zip(names, inside, strict=True)
    )


def aperture() -> Figure:
    """Lights out of focus through four apertures."""
    grid = (15, 15)
    views = scenes.lights(1.3, grid)
    weights = {
        "square": apertures.square(grid),
        "disc": apertures.disc(grid),
        "gaussian, sigma 3": apertures.gaussian(grid, 3.0),
        "mask": apertures.mask(grid, scenes.heart(grid)),
    }
    shapes = [(name, weight / weight.max()) for name, weight in weights.items()]
    lit = [("", lfref.shift_and_sum(views, [0.0], weights=weight)[0]) for weight in weights.values()]
    return sheets.sheet([*shapes, *lit], 4, bar="weight", **sheets.SHARE)


PICTURES: dict[str, Callable[[], Figure]] = {
    "alpha.png": alpha,
    "shift_and_sum.jpg": shift_and_sum,
    "interpolation.jpg": interpolation,
    "borders.jpg": borders,
    "exact_fourier.jpg": exact_fourier,
    "fourier_slice.jpg": fourier_slice,
    "focal_stack_transform.jpg": focal_stack_transform,
    "tilt_shift.jpg": tilt_shift,
    "per_pixel.jpg": per_pixel,
    "homography.jpg": homography,
    "all_in_focus.jpg": all_in_focus,
    "super_resolve.jpg": super_resolve,
    "apertures.jpg": aperture,
    **against_truth.PICTURES,
    **effects.PICTURES,
    **simulator_pictures.PICTURES,
    **against_mitsuba.PICTURES,
    **hard_cases.PICTURES,
    **paper_pictures.PICTURES,
    **browsing.PICTURES,
}


def _along_the_page(views: Tensor) -> Tensor:
    return lfref.tilt_shift(views, -scenes.SLANT * (scenes.SIZE[0] - 1) / 2, (0.0, scenes.SLANT))[0]


def _enlarged(image: Tensor) -> Tensor:
    """Twice finer by bicubic interpolation, fine pixels side by side in each pixel, as `super_resolve` has them."""
    return F.interpolate(image[None], scale_factor=2, mode="bicubic")[0]


def main() -> None:
    """Write all pictures."""
    parser = argparse.ArgumentParser(description="Draw the pictures of the pages.")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *PICTURES], help="files to draw; none: all")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "pictures", help="folder of the pictures")
    arguments = parser.parse_args()
    names = arguments.names or PICTURES
    for name in names:
        sheets.save(PICTURES[name](), arguments.output / name)
    print(f"wrote {len(names)} pictures to {arguments.output}")


if __name__ == "__main__":
    main()
