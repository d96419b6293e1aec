"""Scenes that `pictures` shows: flat cards at three depths, a printed page before pinhole cameras, lights at night.

Letters: `v u` view row and column, `x y` pixel column and row.
"""

import math
from collections.abc import Callable
from typing import Any

import cards
import numpy as np
import torch
from cards import Card
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle, Wedge
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.refocus.anywhere.homography import Cameras

SIZE = (192, 288)
GRID = (7, 7)
FAR, MIDDLE, NEAR = -0.8, 0.1, 0.9  # disparities of the cards, in pixels per view step
FOCAL, SPACING, DISTANCE = 320.0, 0.08, 4.0  # of the pinhole cameras: in pixels, and in units of their world
TABLE = (0.0, -math.cos(0.8), -math.sin(0.8), -math.sin(0.8) * DISTANCE)
"""The plane n.X = d of a table top, as far away in the middle of the picture as `DISTANCE`."""
PRINT, NIGHT = (64, 96), (96, 96)  # height and width of smaller scenes
FINE = 4  # everything is drawn this much finer, then averaged
PAPER, INK, MORTAR, YELLOW, WOOD = "#F3EDE0", "#26231F", "#D9CFC2", "#F2B233", "#7A5230"
AMBER, WHITE, GREEN, BLUE = (1.0, 0.5, 0.12), (0.9, 0.85, 0.75), (0.25, 0.8, 0.45), (0.3, 0.5, 1.0)
LIGHTS = (  # x, y and colour
    (16, 18, AMBER),
    (42, 13, WHITE),
    (70, 20, AMBER),
    (84, 36, BLUE),
    (20, 44, GREEN),
    (52, 38, AMBER),
    (78, 58, WHITE),
)
TEXT = """A light field knows, for every ray of light that
entered the camera, how bright it was and where
it came from. A picture focused anywhere is a
sum over some of these rays: shift each view in
proportion to its place in the aperture, and add.
What lies on the chosen plane falls together and
is sharp; all else is spread by the aperture.
Slant the plane, and a whole table top is sharp.
Let each camera stand where it likes, and shifts
become homographies. Look between the samples,
and there is detail that no single view has seen."""

SMALL = """small print
that no single view
has seen: samples
of all views, each
at its own place"""

Draw = Callable[[Axes, float, float], None]
"""(axes, width, height): draws in pixels, y downwards."""


def still_life() -> tuple[Tensor, Tensor]:
    """A brick wall, a test target before it and a label in front, all flat.

    Returns:
        Views, [7, 7, 3, H, W], and the disparity that the middle view shows, [H, W].
    """
    margin = math.ceil(3 * NEAR) + 2
    drawn = ((FAR, _bricks), (MIDDLE, _target), (NEAR, _label))
    layers = [_layer(disparity, draw, margin, seed) for seed, (disparity, draw) in enumerate(drawn)]
    truth = torch.full(layers[0].opacity.shape[1:], FAR)
    for layer in layers[1:]:
        truth = torch.where(layer.opacity[0] > 0.5, layer.disparity, truth)
    return cards.views(layers, GRID, margin), truth[margin:-margin, margin:-margin]


def wall(disparity: float) -> Tensor:
    """The brick wall with the target on it, one flat surface, [7, 7, 3, H, W]."""
    margin = math.ceil(3 * abs(disparity)) + 2
    both = [_layer(disparity, draw, margin, seed) for seed, draw in enumerate((_bricks, _target))]
    return cards.views(both, GRID, margin)


def camera_array(disorder: float = 0.0) -> Cameras:
    """7x7 pinhole cameras side by side, their sensors shifted so that all look at one point.

    Args:
        disorder: 0 for a perfect array; the larger, the farther they stand off their places, forwards and backwards
            too, and the more each is turned.
    """
    generator = torch.Generator().manual_seed(5)
    rows, columns = (geometry.angular_offsets(n) for n in GRID)
    offsets = torch.stack(torch.broadcast_tensors(columns, rows[:, None]), dim=-1)
    stray, turn = torch.randn(2, *GRID, 3, generator=generator).double()
    # Counted as behind a main lens, which turns the aperture round: what is near moves with the view.
    centre = SPACING * (disorder * stray * torch.tensor([0.3, 0.3, 2.0]) - F.pad(offsets, (0, 1)))
    turned = _rotation(0.004 * disorder * turn)
    intrinsics = pinhole().intrinsics.repeat(*GRID, 1, 1)
    intrinsics[..., :2, 2] -= FOCAL * SPACING / DISTANCE * offsets
    return Cameras(intrinsics, turned, -(turned @ centre[..., None])[..., 0])


def pinhole() -> Cameras:
    """The camera in the middle of the array."""
    height, width = SIZE
    intrinsics = [[FOCAL, 0, (width - 1) / 2], [0, FOCAL, (height - 1) / 2], [0, 0, 1]]
    return Cameras(torch.tensor(intrinsics), torch.eye(3), torch.zeros(3))


def table_top(cameras: Cameras) -> Tensor:
    """A printed page on the table as each camera sees it, [..., 3, H, W]."""
    page = _drawn(_page, SIZE)
    parts = [part.reshape(-1, *part.shape[len(cameras.grid) :]) for part in _parts(cameras)]
    seen = torch.stack([_seen(page, Cameras(*camera)) for camera in zip(*parts, strict=True)])
    return seen.reshape(*cameras.grid, *seen.shape[1:])


def table_slopes() -> tuple[float, tuple[float, float]]:
    """Slope of the table at the top left pixel of the array's middle view, and its change along x and y."""
    to_ray = torch.linalg.inv(pinhole().intrinsics)
    nearness = torch.tensor(TABLE[:3]).double() @ to_ray / TABLE[3]  # 1/z = nearness.(x, y, 1)
    a, b, start = (FOCAL * SPACING * nearness).tolist()
    return start - FOCAL * SPACING / DISTANCE, (a, b)


def small_print(disparity: float) -> tuple[Tensor, Tensor]:
    """Print that is too small for the pixels of one view.

    Args:
        disparity: In pixels per view step, a multiple of 1 / FINE.

    Returns:
        Views, [7, 7, 3, H, W], whose pixels are half as wide as they are apart, and what such pixels see that lie as
        close together as they are wide, [3, 2 H, 2 W].
    """
    fine = F.avg_pool2d(_drawn(_print, PRINT)[:3], 2, stride=1)
    margin, step = FINE * math.ceil(3 * disparity), round(FINE * disparity)
    height, width = (FINE * length - 2 * margin for length in PRINT)

    def view(v: int, u: int) -> Tensor:
        top, left = (margin - step * (place - 3) for place in (v, u))
        return fine[:, top : top + height : FINE, left : left + width : FINE]

    views = torch.stack([torch.stack([view(v, u) for u in range(7)]) for v in range(7)])
    return views, fine[:, margin : margin + height : FINE // 2, margin : margin + width : FINE // 2]


def lights(disparity: float, grid: tuple[int, int]) -> Tensor:
    """Small lights, many times brighter than white, off the plane of a sign at disparity 0, [V, U, 3, H, W]."""
    sign = F.avg_pool2d(_drawn(_sign, NIGHT)[:3], FINE)
    down, right = (disparity * geometry.angular_offsets(n_views)[:, None] for n_views in grid)
    views = sign.repeat(*grid, 1, 1, 1)
    x, y = torch.arange(NIGHT[1]), torch.arange(NIGHT[0])
    for at_x, at_y, colour in LIGHTS:
        rows = (-(y - at_y - down).square() / 2).exp()
        columns = (-(x - at_x - right).square() / 2).exp()
        spots = torch.einsum("vy,ux->vuyx", rows, columns).float()
        views += 25 * torch.tensor(colour)[:, None, None] * spots[:, :, None]
    return views


def heart(grid: tuple[int, int]) -> Tensor:
    """An aperture of the shape of a heart, [V, U]."""
    y, x = (2.5 * geometry.angular_offsets(n_views) / n_views for n_views in grid)
    y = 0.15 - y[:, None]
    return ((x**2 + y**2 - 1) ** 3 < x**2 * y**3).double()


def _layer(disparity: float, draw: Draw, margin: int, seed: int) -> Card:
    """A card as large as the canvas, with a grain of its own."""
    height, width = (length + 2 * margin for length in SIZE)
    drawn = F.avg_pool2d(_drawn(draw, (height, width)), FINE)
    opacity = _softened(drawn[3:])
    colour = _softened(drawn[:3] * drawn[3:]) / opacity.clamp(min=1e-3)
    grain = cards.grain(seed, (height, width))
    return Card(disparity, (colour * (1 + 0.06 * grain)).clamp(0, 1), opacity.clamp(0, 1))


def _drawn(draw: Draw, size: tuple[int, int]) -> Tensor:
    """What a function draws, colour and opacity, `FINE` times finer than the size, [4, FINE H, FINE W]."""
    height, width = size
    # At this resolution a point, the unit of letters, is a pixel.
    figure = Figure(figsize=(width / 72, height / 72), dpi=72 * FINE, facecolor="none")
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    draw(axes, width, height)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return torch.from_numpy(np.array(canvas.buffer_rgba())).movedim(-1, 0) / 255


def _softened(image: Tensor) -> Tensor:
    window = torch.tensor([[1.0, 2.0, 1.0]]) / 4
    kernel = (window.T * window).expand(len(image), 1, 3, 3)
    return F.conv2d(F.pad(image, (1, 1, 1, 1), mode="replicate"), kernel, groups=len(image))


def _bricks(axes: Axes, width: float, height: float) -> None:
    axes.add_patch(Rectangle((0, 0), width, height, color=MORTAR))
    tones = np.random.default_rng(4)
    for row in range(math.ceil(height / 18)):
        for column in range(-1, math.ceil(width / 44)):
            tone = np.array([0.62, 0.33, 0.25]) * tones.uniform(0.75, 1.2)
            axes.add_patch(Rectangle((44 * column + 22 * (row % 2), 18 * row), 40, 14.5, color=tone))


def _target(axes: Axes, width: float, height: float) -> None:
    centre, radius = (0.36 * width, 0.46 * height), 0.36 * height
    axes.add_patch(Circle(centre, radius * 1.08, color="white"))
    for spoke in range(24):
        axes.add_patch(Wedge(centre, radius, 15 * spoke, 15 * spoke + 7.5, color=INK))


def _label(axes: Axes, width: float, height: float) -> None:
    corner, size = (0.55 * width, 0.47 * height), (0.38 * width, 0.42 * height)
    axes.add_patch(FancyBboxPatch(corner, *size, boxstyle="round,pad=0,rounding_size=6", color=YELLOW))
    middle = corner[0] + size[0] / 2
    _write(axes, middle, corner[1] + 0.3 * size[1], "NEAR", fontsize=27, weight="bold")
    _write(
        axes, middle, corner[1] + 0.72 * size[1], "shift each view in\nproportion to its\nplace, and add", fontsize=8.5
    )


def _page(axes: Axes, width: float, height: float) -> None:
    axes.add_patch(Rectangle((0, 0), width, height, color=WOOD))
    axes.add_patch(Rectangle((0.03 * width, 0.04 * height), 0.94 * width, 0.92 * height, color=PAPER))
    _write(axes, width / 2, height / 2, TEXT, fontsize=9.6, linespacing=1.3)


def _print(axes: Axes, width: float, height: float) -> None:
    axes.add_patch(Rectangle((0, 0), width, height, color=PAPER))
    _write(axes, width / 2, height / 2, SMALL, fontsize=6.5, linespacing=1.3)


def _sign(axes: Axes, width: float, height: float) -> None:
    axes.add_patch(Rectangle((0, 0), width, height, color="#0B1020"))
    _write(axes, width / 2, 0.86 * height, "in focus", fontsize=15, weight="bold", color=PAPER)


def _write(axes: Axes, x: float, y: float, text: str, **look: Any) -> None:
    axes.text(x, y, text, **{"color": INK, "ha": "center", "va": "center", **look})


def _parts(cameras: Cameras) -> tuple[Tensor, Tensor, Tensor]:
    return cameras.intrinsics, cameras.rotation, cameras.translation


def _seen(page: Tensor, camera: Cameras) -> Tensor:
    """What one camera sees of the page, [3, H, W]: the rays of four points a pixel are met with the table."""
    height, width = SIZE
    x, y = ((torch.arange(2 * n).double() - 0.5) / 2 for n in (width, height))
    pixels = torch.stack(torch.broadcast_tensors(x, y[:, None], torch.ones(())), dim=-1)
    rays = pixels @ (camera.rotation.mT @ torch.linalg.inv(camera.intrinsics)).mT
    start, normal = -camera.rotation.mT @ camera.translation, torch.tensor(TABLE[:3]).double()
    points = start + rays * ((TABLE[3] - start @ normal) / (rays @ normal))[..., None]
    away = (points[..., 2] - DISTANCE) / -TABLE[1]
    place = torch.stack([points[..., 0] / 1.6, -away / 2.0], dim=-1)
    colours = F.grid_sample(
        page[None, :3], place[None].float(), mode="bicubic", padding_mode="border", align_corners=False
    )
    return F.avg_pool2d(colours, 2)[0].clamp(0, 1)


def _rotation(angles: Tensor) -> Tensor:
    """Rotations by small vectors of angles, [..., 3] -> [..., 3, 3]."""
    a, b, c = angles.unbind(-1)
    zero = torch.zeros_like(a)
    cross = torch.stack([zero, -c, b, c, zero, -a, -b, a, zero], dim=-1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(cross)
