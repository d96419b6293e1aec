"""Simulated scenes for `pictures.py`: three cards, a wall, a slanted page, small print, lights before a sign.

Letters: `v u` view row and column, `x y` pixel column and row, `f c b` as in `turned`.
"""

import functools
import tempfile
from pathlib import Path
from typing import NamedTuple

import torch
from matplotlib.figure import Figure
from torch import Tensor

import lfref
from lfref import geometry
from lfref.simulator import simulate
from lfref.simulator.materials import Emissive
from lfref.simulator.mattes import Disc, Polygon
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat, Noise, Picture, Stripes

SIZE = (192, 288)
GRID = (7, 7)
FAR, MIDDLE, NEAR = -0.8, 0.1, 0.9  # disparities of the cards, in pixels per view step
SLANT = 0.012  # of the page: change of its disparity a row
FOCAL, HORIZON = 320.0, 4.0  # of the turned cameras: in pixels, and what disparities at infinity are below 0
CAMERA = Camera(GRID, SIZE)
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
What lies on the chosen plane falls together and
is sharp; all else is spread by the aperture.
Slant the plane, and a whole page is sharp.
Let each camera look where it likes, and shifts
become homographies. Look between the samples,
and there is detail that no single view has seen."""
SMALL = "small print\nthat no single view\nhas seen: samples\nof all views, each\nat its own place"


@functools.cache
def still_life() -> tuple[Tensor, Tensor]:
    """A wall, stripes before it and a label in front: views, [7, 7, 3, H, W], and disparity, [H, W]."""
    plaster = Noise((0.5, 0.33, 0.27), (0.25, 0.2, 0.18), exponent=1.1, hardness=0.6)
    label = _page("all that\nis NEAR\nis sharp", (SIZE[1], SIZE[0]), 20, (0.74, 0.31), paper=YELLOW)
    scene = Scene(
        CAMERA,
        (
            Surface(Plane(FAR), plaster),
            Surface(Plane(MIDDLE), Stripes(7, (0.1, 0.1, 0.12), (0.95, 0.95, 0.95), 65), Disc(66, (-46, -10))),
            Surface(Plane(NEAR), label, Polygon(((14, -4), (124, -4), (124, 76), (14, 76)))),
        ),
    )
    simulated = lfref.simulate(scene, outputs=("views", "disparity"), slopes=[0.0])
    return simulated.views, simulated.disparity


@functools.cache
def wall(disparity: float) -> Tensor:
    """A wall of fine tiles, [7, 7, 3, H, W]."""
    return _views(CAMERA, Surface(Plane(disparity), Checker(9, (0.62, 0.33, 0.25), (0.95, 0.9, 0.82), angle=24)))


@functools.cache
def slanted_page() -> Tensor:
    """A printed page, its lower edge near, at disparity 0 in the middle, [7, 7, 3, H, W]."""
    return _views(CAMERA, Surface(Plane(0.0, (0.0, SLANT)), _page(TEXT, (SIZE[1], SIZE[0]), 10)))


class Cameras(NamedTuple):
    """Pinhole cameras: a world point X is at pixel K (R X + t), homogeneous."""

    intrinsics: Tensor
    """K in pixels, float64, [..., 3, 3]."""
    rotation: Tensor
    """R from world to camera axes, float64, [..., 3, 3]."""
    translation: Tensor
    """t in world units, float64, [..., 3]."""


def plane_homographies(cameras: Cameras, reference: Cameras, planes: Tensor) -> Tensor:
    """Homographies that planes n.X = d (n_x, n_y, n_z, d), [N, 4], induce between a reference picture and each view.

    A pixel p at depth z is X = centre + z to_ray p. On the plane 1/z = q.p is linear in p: the homography.
    """
    to_ray = reference.rotation.mT @ torch.linalg.inv(reference.intrinsics)
    centre = -reference.rotation.mT @ reference.translation
    normals, distances = planes.double()[:, :3], planes.double()[:, 3]
    inverse_depth = normals @ to_ray / (distances - normals @ centre)[:, None]
    inverse_depth = inverse_depth.reshape(-1, *(1 for _ in cameras.intrinsics.shape[:-2]), 1, 3)
    turned, offset = cameras.rotation @ to_ray, cameras.rotation @ centre + cameras.translation
    return cameras.intrinsics @ (turned + offset[..., None] * inverse_depth)


def turned(views: Tensor) -> tuple[Tensor, Cameras]:
    """The views of the page as cameras see it that are each turned a little, and these cameras.

    A pinhole of focal length f that stands at (-p, -q, 0) and whose picture goes back by c p sees the depth Z at the
    disparity f / Z - c; turned by R it has at K R K^-1 x what it had at x.
    """
    turn = torch.randn(*GRID, 3, generator=torch.Generator().manual_seed(5)).double() * 0.004
    a, b, c = turn.unbind(-1)
    zero = torch.zeros_like(a)
    rotation = torch.linalg.matrix_exp(torch.stack([zero, -c, b, c, zero, -a, -b, a, zero], -1).unflatten(-1, (3, 3)))
    q, p = (geometry.angular_offsets(n_views) for n_views in GRID)
    places = torch.stack([*torch.broadcast_tensors(p, q[:, None]), zero], -1)
    intrinsics = pinhole().intrinsics.repeat(*GRID, 1, 1)
    intrinsics[..., :2, 2] -= HORIZON * places[..., :2]
    matrices = intrinsics @ rotation.mT @ torch.linalg.inv(intrinsics)
    turned_views = [
        lfref.homography(views[v : v + 1, u : u + 1], matrices[v : v + 1, u : u + 1], "cubic", "edge")[0]
        for v in range(GRID[0])
        for u in range(GRID[1])
    ]
    cameras = Cameras(intrinsics, rotation, (rotation @ places[..., None])[..., 0])
    return torch.stack(turned_views).unflatten(0, GRID), cameras


def pinhole() -> Cameras:
    """The camera in the middle, not turned."""
    height, width = SIZE
    intrinsics = [[FOCAL, 0, (width - 1) / 2], [0, FOCAL, (height - 1) / 2], [0, 0, 1]]
    return Cameras(torch.tensor(intrinsics, dtype=torch.float64), torch.eye(3).double(), torch.zeros(3).double())


def page_plane() -> Tensor:
    """The page in the world of the turned cameras, n.X = d: f / Z - c = b f Y / Z, [1, 4]."""
    return torch.tensor([[0.0, SLANT * FOCAL, HORIZON, FOCAL]])


def small_print(disparity: float) -> tuple[Tensor, Tensor]:
    """Print too small for a view: views [7, 7, 3, H, W], and the middle one with pixels half as large."""
    scene = Scene(Camera(GRID, (56, 88), samples=2), (Surface(Plane(disparity), _page(SMALL, (96, 64), 5.5)),))
    fine = lfref.simulate(simulate.finer(scene, 2), outputs=("all_in_focus",)).all_in_focus
    return lfref.simulate(scene, outputs=("views",), slopes=[0.0]).views, fine


def lights(disparity: float, grid: tuple[int, int]) -> Tensor:
    """Small lights, many times brighter than white, off the plane of a sign at disparity 0, [V, U, 3, H, W]."""
    sign = Surface(Plane(0.0), _page("in focus", (96, 96), 15, (0.5, 0.14), PAPER, NIGHT))
    lamps = (Surface(Plane(disparity), Flat(colour), Disc(1.4, (x, y)), Emissive(25)) for x, y, colour in LIGHTS)
    return _views(Camera(grid, (96, 96)), sign, *lamps)


def heart(grid: tuple[int, int]) -> Tensor:
    """An aperture of the shape of a heart, [V, U]."""
    y, x = (2.5 * geometry.angular_offsets(n_views) / n_views for n_views in grid)
    y = 0.15 - y[:, None]
    return ((x**2 + y**2 - 1) ** 3 < x**2 * y**3).double()


def _views(camera: Camera, *surfaces: Surface) -> Tensor:
    return lfref.simulate(Scene(camera, surfaces), outputs=("views",), slopes=[0.0]).views


@functools.cache
def _page(
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
