"""Draw the pictures of the pages from simulated scenes. Run by `make figures`.

A picture is a sheet of titled cells, 900 pixels wide. Plots of tables are drawn where `make figures` has left them.
Letters: `s` slope in pixels per view step, `v u` view row and column, `x y` pixel column and row.
"""

import argparse
import dataclasses
import functools
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pages
import torch
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from PIL import Image
from torch import Tensor
from torch.nn import functional as F

import lfref
from lfref import geometry
from lfref.bench.evaluation import IDEAL
from lfref.bench.timing import FFT
from lfref.functional.psnr import psnr
from lfref.io import atomic
from lfref.refocus.apertures import disc, gaussian, mask, square
from lfref.refocus.focus.all_in_focus import index_to_slope
from lfref.report import drawing, plots, tables
from lfref.report.pictures import for_display
from lfref.simulator import sim30, simulate
from lfref.simulator.effects.sensor import EFFECTS, Sensor
from lfref.simulator.materials import Emissive, Glass, Glossy, Matte, Mirror
from lfref.simulator.mattes import Disc, Leaf, Polygon, Twigs
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat, Noise, Picture, Stripes

WIDTH = 6.0  # inches
BAR_WIDTH = 0.75
TITLE: dict[str, Any] = {"fontsize": 8, "color": drawing.BLACK, "pad": 3}
JPEG = {"format": "jpg", "pil_kwargs": {"quality": 83, "subsampling": 0, "optimize": True}}
LEAST = 1e-6  # smaller errors are shown as none: zero has no logarithm
ERROR: dict[str, Any] = {"cmap": "magma", "norm": LogNorm(LEAST, 1)}
COARSE = 1e-4
DIFFERENCE: dict[str, Any] = {"bar": "absolute difference", "cmap": "magma", "norm": LogNorm(COARSE, 0.1)}
SHARE: dict[str, Any] = {"cmap": "cividis", "vmin": 0, "vmax": 1}
SLOPE_LABEL = "slope, px per view step"

# Sheets


def sheet(cells: Iterable[tuple[str, Tensor]], n_columns: int = 3, bar: str = "", **style: Any) -> Figure:
    """Cells of one shape in reading order: pictures, [C, H, W], or maps, [H, W], with a colour bar that says `bar`."""
    cells = list(cells)
    n_rows, n_lines = -(-len(cells) // n_columns), cells[0][0].count("\n") + 1
    (height, width), room = cells[0][1].shape[-2:], WIDTH - (BAR_WIDTH if bar else 0)
    figure = drawing.new_figure(WIDTH, n_rows * (room / n_columns * height / width + 0.18 * n_lines))
    figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0, hspace=0)
    grid = figure.subplots(n_rows, n_columns, squeeze=False)
    shown = [(show(axes, *cell, **style), cell[1].ndim) for axes, cell in zip(grid.flat, cells, strict=True)]
    maps = [image for image, ndim in shown if ndim == 2]
    if maps:
        legend = figure.colorbar(maps[0], ax=[image.axes for image in maps], pad=0.01, aspect=15)
        legend.set_label(bar, fontsize=8)
        legend.ax.tick_params(labelsize=7)
    return figure


def show(axes: Axes, title: str, values: Tensor, **style: Any) -> AxesImage:
    """A picture, [C, H, W], as it is, or a map, [H, W], in a style."""
    axes.set_axis_off()
    axes.set_title(title, **TITLE)
    return axes.imshow(values, **style) if values.ndim == 2 else axes.imshow(for_display(values))


def error(title: str, image: Tensor, truth: Tensor, least: float = LEAST) -> tuple[str, Tensor]:
    """A cell with the error of an image, from `least` on, its PSNR at the end of the title."""
    return f"{title}{decibels(image, truth)}", (image - truth).abs().mean(0).clamp(min=least)


def decibels(image: Tensor, truth: Tensor) -> str:
    """PSNR as it is written."""
    value = float(psnr(image, truth))
    return f"{value:.0f} dB" if value < tables.CAP_DB else f"≥ {tables.CAP_DB:.0f} dB"


def at(slope: float) -> str:
    """A slope as it is written."""
    return f"s = {slope:+.3g}".replace("-", tables.MINUS) if slope else "s = 0"


def label(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Names of the axes, in letters as small as those of the cells."""
    drawing.style_axes(axes, x, y, "")
    axes.set_title(title, **TITLE)
    axes.tick_params(labelsize=7)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set_size(8)


def save(figure: Figure, path: Path) -> None:
    """Write a figure, all or nothing, as its suffix says: `.jpg` or `.png`."""
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, **drawing.PNG | (JPEG if path.suffix == ".jpg" else {}))
        if path.suffix == ".png" and not any(axes.images for axes in figure.axes):
            # Lines and letters have few colours: a palette takes a third of the bytes.
            with Image.open(temporary) as drawn:
                drawn.convert("RGB").quantize().save(temporary, optimize=True)


# Scenes of the page on refocusing

SHAPE, GRID = (192, 288), (7, 7)
CAMERA = Camera(GRID, SHAPE)
FAR, MIDDLE, NEAR = -0.8, 0.1, 0.9  # disparities of the cards, in pixels per view step
SLANT = 0.012  # of the page: change of its disparity a row
DEPTH: dict[str, Any] = {"bar": SLOPE_LABEL, "cmap": "viridis", "vmin": FAR, "vmax": NEAR}
FOLDER = tempfile.TemporaryDirectory()
PAPER, INK, YELLOW, NIGHT = "#F3EDE0", "#26231F", "#F2B233", "#0B1020"
AMBER, WHITE, GREEN, BLUE = (1.0, 0.5, 0.12), (0.9, 0.85, 0.75), (0.25, 0.8, 0.45), (0.3, 0.5, 1.0)
LIGHTS = (  # x, y from the middle and colour
    (-32, -30, AMBER),
    (-6, -35, WHITE),
    (22, -28, AMBER),
    (36, -12, BLUE),
    (-28, -4, GREEN),
    (4, -10, AMBER),
    (30, 10, WHITE),
)
TEXT = """A light field knows, for every ray of light that
entered the camera, how bright it was and where
it came from. A picture focused anywhere is a
sum over some of these rays: shift each view in
proportion to its place in the aperture, and add.
Slant the plane, and a whole page is sharp."""
SMALL = "small print\nthat no single view\nhas seen: samples\nof all views, each\nat its own place"


def views_of(camera: Camera, *surfaces: Surface) -> Tensor:
    """Views of surfaces, [V, U, 3, H, W]."""
    return lfref.simulate(Scene(camera, surfaces), outputs=("views",), slopes=[0.0]).views


@functools.cache
def printed(
    text: str,
    size: tuple[int, int],
    letters: float,
    middle: tuple[float, float] = (0.5, 0.5),
    ink: str = INK,
    paper: str = PAPER,
) -> Picture:
    """A printed page as wide and high as some pixels, four times finer than these; a point of letters is a pixel."""
    figure = Figure(figsize=(size[0] / 72, size[1] / 72), dpi=4 * 72, facecolor=paper)
    figure.text(*middle, text, fontsize=letters, linespacing=1.3, color=ink, ha="center", va="center")
    path = Path(FOLDER.name) / f"{len(text)}.png"
    figure.savefig(path)
    return Picture(str(path), size[0])


@functools.cache
def still_life() -> tuple[Tensor, Tensor]:
    """A wall, stripes before it and a label in front: views, [7, 7, 3, H, W], and disparity, [H, W]."""
    plaster = Noise((0.5, 0.33, 0.27), (0.25, 0.2, 0.18), exponent=1.1, hardness=0.6)
    sharp = printed("all that\nis NEAR\nis sharp", (SHAPE[1], SHAPE[0]), 20, (0.74, 0.31), paper=YELLOW)
    surfaces = (
        Surface(Plane(FAR), plaster),
        Surface(Plane(MIDDLE), Stripes(7, (0.1, 0.1, 0.12), (0.95, 0.95, 0.95), 65), Disc(66, (-46, -10))),
        Surface(Plane(NEAR), sharp, Polygon(((14, -4), (124, -4), (124, 76), (14, 76)))),
    )
    simulated = lfref.simulate(Scene(CAMERA, surfaces), outputs=("views", "disparity"), slopes=[0.0])
    return simulated.views, simulated.disparity


@functools.cache
def wall(disparity: float) -> Tensor:
    """A wall of fine tiles, [7, 7, 3, H, W]."""
    return views_of(CAMERA, Surface(Plane(disparity), Checker(9, (0.62, 0.33, 0.25), (0.95, 0.9, 0.82), angle=24)))


# Pictures of the page on refocusing


def shift_and_sum() -> Figure:
    """The still life, focused far, in the middle and near."""
    slopes = [FAR, MIDDLE, NEAR]
    return sheet(zip(map(at, slopes), lfref.shift_and_sum(still_life()[0], slopes), strict=True))


def interpolation() -> Figure:
    """A wall in focus at half-pixel shifts by each interpolation, and what each does wrong."""
    views, slope = wall(0.5), [0.5]
    exact = lfref.exact_fourier(views, slope)[0]
    window = (..., slice(64, 112), slice(68, 140))
    names = ("nearest", "linear", "cubic")
    shown = [(name, lfref.shift_and_sum(views, slope, interpolation=name)[0][window]) for name in names]
    errors = [error("error, PSNR ", image, exact[window]) for _, image in shown]
    return sheet([*shown, *errors], 3, bar="absolute error", **ERROR)


def fourier_slice() -> Figure:
    """Errors of Fourier slices against the reference, by kernel and padding."""
    views, _ = still_life()
    exact = lfref.exact_fourier(views, [NEAR])[0]
    settings: dict[str, dict[str, Any]] = {
        "linear,\nnot padded: ": {"kernel": "linear", "padding": 1},
        "linear,\npadded twice: ": {"kernel": "linear", "padding": 2},
        "Kaiser-Bessel, 4 bins,\npadded twice: ": {"width": 4},
        "Kaiser-Bessel, 6 bins,\npadded twice: ": {"width": 6},
    }
    stacks = {name: lfref.fourier_slice(views, [NEAR], **options) for name, options in settings.items()}
    return sheet((error(name, stack[0], exact) for name, stack in stacks.items()), 4, bar="absolute error", **ERROR)


def tilt_shift() -> Figure:
    """A printed page, its lower edge near: one slope for the picture, and one that changes from top to bottom."""
    page = printed(f"{TEXT}\n{TEXT}", (SHAPE[1], SHAPE[0]), 10)
    views = views_of(CAMERA, Surface(Plane(0.0, (0.0, SLANT)), page))
    flat = lfref.shift_and_sum(views, [0.0])[0]
    tilted = lfref.tilt_shift(views, -SLANT * (SHAPE[0] - 1) / 2, (0.0, SLANT))[0]
    return sheet([("one view", views[3, 3]), ("shift_and_sum, s = 0", flat), ("tilt_shift", tilted)])


def per_pixel() -> Figure:
    """Noisy views averaged along a map of slopes."""
    views, truth = still_life()
    noisy = views + 0.12 * torch.randn(views.shape, generator=torch.Generator().manual_seed(0))
    refocused = lfref.per_pixel(noisy, truth, interpolation="cubic")[0]
    return sheet([("one of 49 noisy views", noisy[3, 3]), ("per_pixel", refocused), ("slope_map", truth)], **DEPTH)


def all_in_focus() -> Figure:
    """The still life, sharp throughout, and the slope at which each pixel is sharpest."""
    views, truth = still_life()
    slopes = geometry.even_slopes(17, -1.2, 1.2)
    image, index, confidence = lfref.all_in_focus(lfref.exact_fourier(views, slopes))
    pair = [("image", image), ("confidence, white: 1", confidence[None])]
    maps = [("index, as slope", index_to_slope(index, slopes)), ("true disparity", truth)]
    return sheet([*pair, *maps], 2, **DEPTH)


def super_resolve() -> Figure:
    """Print too small for a view: in one view, refocused and enlarged, and super-resolved."""
    slope, inner = [0.25], (..., slice(6, -6), slice(6, -6))
    surface = Surface(Plane(slope[0]), printed(SMALL, (96, 64), 5.5))
    scene = Scene(Camera(GRID, (56, 88), samples=2), (surface,))
    views = views_of(scene.camera, surface)
    truth = lfref.simulate(simulate.finer(scene, 2), outputs=("all_in_focus",)).all_in_focus[inner]
    mean = lfref.exact_fourier(views, slope)[0]
    # Fine pixels lie side by side in each pixel, as `super_resolve` has them.
    enlarged = F.interpolate(torch.stack([views[3, 3], mean]), scale_factor=2, mode="bicubic")
    names = ("one view, bicubic", "shift_and_sum, bicubic", "super_resolve")
    images = [image[inner] for image in (*enlarged, lfref.super_resolve(views, slope, factor=2)[0])]
    return sheet((f"{name}: {decibels(image, truth)}", image) for name, image in zip(names, images, strict=True))


def apertures() -> Figure:
    """Small lights, many times brighter than white, out of focus before a sign, through four apertures."""
    grid, size = (15, 15), (96, 96)
    sign = Surface(Plane(0.0), printed("in focus", size, 15, (0.5, 0.14), PAPER, NIGHT))
    lamps = (Surface(Plane(1.3), Flat(colour), Disc(1.4, (x, y)), Emissive(25)) for x, y, colour in LIGHTS)
    views = views_of(Camera(grid, size), sign, *lamps)
    y, x = (2.5 * geometry.angular_offsets(n_views) / n_views for n_views in grid)
    y = 0.15 - y[:, None]
    weights = {
        "square": square(grid),
        "disc": disc(grid),
        "gaussian, sigma 3": gaussian(grid, 3.0),
        "mask": mask(grid, ((x**2 + y**2 - 1) ** 3 < x**2 * y**3).double()),  # a heart
    }
    shapes = [(name, weight / weight.max()) for name, weight in weights.items()]
    lit = [("", lfref.shift_and_sum(views, [0.0], weights=weight)[0]) for weight in weights.values()]
    return sheet([*shapes, *lit], 4, bar="weight", **SHARE)


INNER = (..., slice(24, -24), slice(24, -24))  # every view covers it at all the paper's planes


def views_and_truth(slope: float) -> tuple[Tensor, Tensor]:
    """Views of a scene of sim30, and the inner part of its truth at a slope."""
    result = lfref.simulate(sim30.SCENES["twigs"], slopes=(slope,))
    return result.views, result.truth[0][INNER]


def cells() -> Figure:
    """A scene far out of focus: the sum over points, the integral over cells, and the lens."""
    slope = -7.0  # the widest blur among the paper's planes
    views, truth = views_and_truth(slope)
    points, filled = (lfref.shift_and_sum(views, [slope], "cubic", fill_factor=fill)[0][INNER] for fill in (0.0, 1.0))
    shown = [
        ("truth", truth),
        ("49 points", points),
        ("49 cells, fill_factor=1", filled),
        ("one view", views[3, 3][INNER]),
    ]
    errors = [error("difference, ", picture, truth, COARSE) for picture in (points, filled)]
    return sheet([*shown, *errors], **DIFFERENCE)


def near_focus() -> Figure:
    """A scene focused on one of its surfaces, by four methods: what each does wrong."""
    slope = [0.5]
    views, truth = views_and_truth(slope[0])
    stacks = {
        "exact_fourier": lfref.exact_fourier(views, slope),
        "exact_fourier, fill_factor=1": lfref.exact_fourier(views, slope, fill_factor=1.0),
        "refocus_by_layers": lfref.refocus_by_layers(views, slope),
        "blockwise_wiener": lfref.blockwise_wiener(views, slope),
    }
    errors = (error(f"{name}\n", stack[0][INNER], truth, COARSE) for name, stack in stacks.items())
    return sheet(errors, 4, **DIFFERENCE)


def disparity_map() -> Figure:
    """Disparity map of the still life, its confidence, and the true disparity."""
    views, truth = still_life()
    estimate = lfref.disparity_map(views)
    shown = [
        ("confidence, white: 1", estimate.confidence[None]),
        ("disparity_map", estimate.disparity),
        ("truth", truth),
    ]
    return sheet(shown, **DEPTH | {"bar": "disparity, px per view step"})


# Pictures of the page on the simulator

SMALL_CAMERA = Camera(size=(96, 144))
CLOTH = Checker(16.0, (0.75, 0.15, 0.12), (0.90, 0.86, 0.78), angle=12)
PLASTER = Surface(Plane(-0.8), Noise((0.45, 0.43, 0.40), (0.2, 0.2, 0.2), exponent=2.0, grain=0.005))
CARD = Surface(Plane(0.2), CLOTH, Polygon(((-60, -34), (0, -40), (8, 30), (-54, 36))))
LID = Surface(Plane(0.8), Stripes(9.0, (0.10, 0.20, 0.40), (0.92, 0.92, 0.88), angle=65), Disc(24, (34, 8)))
MOSS = Noise((0.15, 0.3, 0.1), (0.1, 0.2, 0.1), hardness=0.5)
GARDEN = Scene(
    SMALL_CAMERA,
    (
        Surface(Plane(-3.0), Checker(48.0, (0.35, 0.25, 0.2), (0.8, 0.75, 0.65), angle=8)),
        Surface(Plane(1.8), MOSS, Leaf(90, 36, -35, (-28, 0))),
        Surface(Plane(1.8), MOSS, Twigs(30, 2, 4, foot=(40, 46), seed=8)),
    ),
)


def simulator_materials() -> Figure:
    """Each material in dim light, as matte, and as it looks from the left and from the right."""
    shown = []
    for surface in (
        Surface(Plane(0.2), Flat((0.5, 0.1, 0.08)), Disc(40), Glossy(0.8, 10, 4)),
        Surface(Plane(0.2), Flat((0.5, 0.5, 0.5)), Disc(40), Mirror(0.85, CLOTH, -2.0)),
        Surface(Plane(0.2), Flat((0.5, 0.5, 0.5)), Disc(40), Glass(0.3, CLOTH, -2.0), opacity=0.1),
        Surface(Plane(0.2), Flat((0.9, 0.6, 0.2)), Disc(12), Emissive(1.0)),
    ):
        matte = dataclasses.replace(surface, material=Matte(), opacity=1.0)
        before, after = (
            lfref.simulate(Scene(SMALL_CAMERA, (PLASTER, each), Light(0.6)), outputs=("views",)).views[3]
            for each in (matte, surface)
        )
        name = type(surface.material).__name__
        shown += [("Matte", before[3]), (f"{name}, from the left", after[0]), ("from the right", after[6])]
    return sheet(shown)


def simulator_sensor() -> Figure:
    """The view in the corner of the aperture with each effect of optics, sensor and software."""
    effects: dict[str, tuple[Any, ...]] = {
        "vignetting": (0.7,),
        "misalignment": (0.5,),
        "crosstalk": (0.3,),
        "exposure": (0.5,),
        "mosaic": ("BGGR",),
        "noise": (0.003, 3e-4),
        "clipping": (0.3, 0.7),
        "quantisation": (3,),
        "white_balance": ((1.2, 1.0, 0.6),),
        "tone_curve": ("srgb",),
    }
    sensors = {"\noff": Sensor(), "cat's eye\ncats_eye 0.7": Sensor(vignetting=EFFECTS["vignetting"](0.0, 0.7))}
    for name, values in effects.items():
        effect = EFFECTS[name](*values)
        fields = [field.name for field in dataclasses.fields(effect)][: len(values)]
        title = f"{type(effect).__name__}\n{', '.join(f'{field} {getattr(effect, field)}' for field in fields)}"
        sensors[title] = Sensor(**{name: effect})
    scenes = {title: Scene(SMALL_CAMERA, (PLASTER, CARD, LID), sensor=sensor) for title, sensor in sensors.items()}
    views = {title: lfref.simulate(scene, outputs=("views",)).views for title, scene in scenes.items()}
    return sheet(((title, of_sensor[0, 0]) for title, of_sensor in views.items()), 4)


def simulator_truth() -> Figure:
    """The truth at two slopes, the same from 49 views, and what these lack."""
    result = lfref.simulate(GARDEN, slopes=(-3.0, 1.8))
    summed = lfref.shift_and_sum(result.views, result.slopes)
    shown = []
    for slope, lens, views in zip(result.slopes.tolist(), result.truth, summed, strict=True):
        shown += [(f"truth, {at(slope)}", lens), ("shift_and_sum of 49 views", views)]
        shown.append(error("difference, ", views, lens, COARSE))
    return sheet(shown, **DIFFERENCE)


def simulator_sim30() -> Figure:
    """The middle view of every scene of sim30."""
    views = {name: lfref.simulate(scene, outputs=("views",)).views for name, scene in sim30.SCENES.items()}
    return sheet(((name, of_scene[3, 3]) for name, of_scene in views.items()), 10)


# Plots of tables

RUNS = {
    "accuracy_time.png": pages.FIGURES / "bench" / "bench.csv",
    "causes.png": pages.FIGURES / "causes" / "causes_by_plane.csv",
    "stability.png": pages.FIGURES / "stability" / "stability.csv",
}
"""Plot -> the table that it is drawn from."""
DULL = "benign|black prediction|wide|batch of 1|NaN|infinity"
"""Hard cases that are not shown."""


def accuracy_time() -> Figure:
    """Accuracy against time in the scenes without a sensor's effects."""
    rows = tables.read_table(RUNS["accuracy_time.png"])
    return plots.front(rows[(rows["class"] == IDEAL) | (rows["method"] == FFT)])


def causes() -> Figure:
    """Cost of each cause of error, and gains of the remedies."""
    return plots.error_causes(tables.read_table(RUNS["causes.png"]), panels_at=(0.125, 2.0))


def stability() -> Figure:
    """Trials of 1 - SSIM and of the loss in three precisions."""
    rows = tables.read_table(RUNS["stability.png"])
    rows = rows[rows["component"].isin(["1 - SSIM", "loss"]) & ~rows["case"].str.contains(DULL)]
    return plots.heat_map(rows[rows["precision"].isin(["float32", "float16", "autocast bfloat16"])])


PHOTOGRAPHIC = (
    *(shift_and_sum, interpolation, fourier_slice, tilt_shift),
    *(per_pixel, all_in_focus, super_resolve, apertures, cells, near_focus, disparity_map),
    *(simulator_materials, simulator_sensor, simulator_truth, simulator_sim30),
)
DRAWN = {f"{draw.__name__}.jpg": draw for draw in PHOTOGRAPHIC}
DRAWN |= {f"{draw.__name__}.png": draw for draw in (accuracy_time, causes, stability)}
"""Name of a picture -> its function."""


def main() -> None:
    """Write all pictures."""
    parser = argparse.ArgumentParser(description="Draw the pictures of the pages.")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *DRAWN], help="files to draw; none: all")
    parser.add_argument("--output", type=Path, default=pages.PICTURES, help="folder of the pictures")
    arguments = parser.parse_args()
    names = arguments.names or [name for name in DRAWN if name not in RUNS or RUNS[name].is_file()]
    for name in names:
        save(DRAWN[name](), arguments.output / name)
    print(f"wrote {len(names)} pictures to {arguments.output}")


if __name__ == "__main__":
    main()
