"""What simulating costs, pass by pass, and how far refocused views are from the truth.

Planned passes run where they change a result; forced ones run all the same. A scene of few effects should cost less
planned, and one of all effects no more. Errors are where every view covers every pixel.
Letters: `N` planes, `H W` height and width.
"""

import functools
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import pandas as pd
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from lfref.bench import accuracy, timing
from lfref.bench.accuracy import Row
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes, Slopes
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator import bitmaps, truth
from lfref.simulator import views as render
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.layers import Layer
from lfref.simulator.scene import Camera, Scene
from lfref.simulator.scenes import Scenes
from lfref.simulator.simulate import Simulated, simulate

ASKED = {"views": ("views",), "truth": ("truth",), "views and truth": ("views", "truth")}
"""Results by what tables call them."""


class Work(NamedTuple):
    """One simulation that is timed."""

    scene: Scene
    asked: str
    """A key of `ASKED`."""
    is_forced: bool

    def run(self, slopes: Slopes, device: torch.device, timed: bool = False) -> Simulated:
        """Simulate."""
        return simulate(self.scene, 0, ASKED[self.asked], slopes, self.is_forced, device, timed)


def costs(
    scenes: Mapping[str, Scene], slopes: Slopes, device: torch.device, rounds: Iterable[int], warmup: int = 1
) -> list[Row]:
    """Time planned against forced simulation of every scene, all taking turns.

    Args:
        scenes: By class.
        slopes: Of the truth's planes in pixels per view step, [N].
        device: Where it is rendered.
        rounds: One item a round.
        warmup: How many of the first rounds do not count.

    Returns:
        Rows `scene, asked, planned_s, forced_s, forced_over_planned` with medians in seconds.
    """
    watches = {
        (name, asked, is_forced): functools.partial(
            timing.seconds, functools.partial(Work(scene, asked, is_forced).run, slopes, device), device
        )
        for name, scene in scenes.items()
        for asked in ("views", "truth")
        for is_forced in (False, True)
    }
    median = {key: statistics.median(times) for key, times in timing.in_turns(watches, rounds, warmup).items()}
    return [
        {
            "scene": name,
            "asked": asked,
            "planned_s": median[name, asked, False],
            "forced_s": median[name, asked, True],
            "forced_over_planned": median[name, asked, True] / median[name, asked, False],
        }
        for name, asked, is_forced in watches
        if not is_forced
    ]


def passes(scenes: Mapping[str, Scene], slopes: Slopes, device: torch.device) -> list[Row]:
    """Time of every pass that runs for views and truth.

    Args:
        scenes: By class.
        slopes: Of the truth's planes in pixels per view step, [N].
        device: Where it is rendered.

    Returns:
        Rows `scene, pass, milliseconds, share`; the shares of a scene add up to 1.
    """
    rows: list[Row] = []
    for name, scene in scenes.items():
        work = Work(scene, "views and truth", False)
        work.run(slopes, device)  # compiles what is not compiled yet
        rows_of_passes = work.run(slopes, device, timed=True).rows
        taken = {row.name: row.milliseconds for row in rows_of_passes if row.milliseconds is not None}
        total = sum(taken.values())
        rows += [
            {"scene": name, "pass": each, "milliseconds": spent, "share": spent / total}
            for each, spent in taken.items()
        ]
    return rows


class Patches(Dataset[int]):
    """Random scenes, simulated one by one and thrown away, as the workers of a data loader would."""

    def __init__(self, scenes: Scenes, n_scenes: int, asked: str, slopes: Tensor, device: torch.device) -> None:
        self.scenes, self.n_scenes, self.asked, self.slopes, self.device = scenes, n_scenes, asked, slopes, device

    def __len__(self) -> int:
        return self.n_scenes

    def __getitem__(self, index: int) -> int:
        Work(self.scenes.scene(0, 0, index), self.asked, False).run(self.slopes, self.device)
        return index


def rates(scenes: Scenes, n_scenes: int, slopes: Tensor, device: torch.device, n_workers: int = 0) -> list[Row]:
    """How many random scenes are simulated in a second, one patch each, without waiting for the first ones.

    Args:
        scenes: Where they come from, of the size of a patch.
        n_scenes: How many.
        slopes: Of the truth's planes in pixels per view step, [N].
        device: Where they are rendered.
        n_workers: Processes of one thread that share them; 0: this process, with all its threads.

    Returns:
        Rows `asked, n_scenes, n_workers, per_second`.
    """
    n_first = 4 * max(1, n_workers)  # workers are a few scenes ahead of what was fetched
    rows: list[Row] = []
    for asked in ("views", "views and truth"):
        patches = Patches(scenes, n_first + n_scenes, asked, slopes, device)
        fetched = iter(DataLoader(patches, batch_size=None, num_workers=n_workers))
        for _ in range(n_first):
            next(fetched)
        taken = timing.seconds(functools.partial(list, fetched), device)
        rows.append({"asked": asked, "n_scenes": n_scenes, "n_workers": n_workers, "per_second": n_scenes / taken})
    return rows


@torch.no_grad()
def distances(
    scenes: Iterable[tuple[str, Scene]], methods: Sequence[Refocuser], planes: FocalPlanes, device: torch.device
) -> list[Row]:
    """How far stacks of refocused views are from the truth, linear and without the sensor's effects.

    Args:
        scenes: Names and scenes.
        methods: Refocus the views.
        planes: Of the stacks.
        device: Where all is done.

    Returns:
        Rows `scene, method, alpha, slope, psnr_db`.
    """
    rows: list[Row] = []
    for name, scene in scenes:
        # A sensor's noise and clipping are no fault of refocusing.
        clean = replace(scene, sensor=Sensor())
        made = simulate(clean, 0, ("views", "truth"), planes.slopes, device=device)
        assert made.views is not None
        assert made.truth is not None
        for method in methods:
            errors = plane_errors(method(made.views, planes.slopes), made.truth, planes.slopes, made.views)
            rows += [
                {"scene": name, "method": method.name} | place | {"psnr_db": value}
                for place, value in zip(accuracy.plane_names(planes), errors, strict=True)
            ]
    return rows


def plane_errors(stack: Tensor, reference: Tensor, slopes: Tensor, views: Tensor) -> list[float]:
    """PSNR of every plane in dB, where every view covers the pixel; peak 1.

    Args:
        stack: [N, C, H, W].
        reference: Likewise.
        slopes: Of the planes in pixels per view step, [N].
        views: That the stack was made of, [V, U, C, H, W].
    """
    grid = (views.shape[0], views.shape[1])
    return [
        accuracy.interior_errors(image[None], true[None], slope[None], grid)["psnr_db"]
        for image, true, slope in zip(stack.cpu(), reference.cpu(), slopes, strict=True)
    ]


def by_plane(rows: Iterable[Row]) -> pd.DataFrame:
    """Mean and worst distance from the truth over scenes.

    Args:
        rows: Of `distances`.

    Returns:
        Columns `method, alpha, slope, mean_db, worst_db, worst_scene`.
    """
    table = pd.DataFrame(rows)
    groups = table.groupby(["method", "alpha", "slope"], sort=False, dropna=False)["psnr_db"]
    worst = table["scene"][groups.idxmin()].to_numpy()
    return groups.agg(mean_db="mean", worst_db="min").assign(worst_scene=worst).reset_index()


@torch.no_grad()
def aperture_errors(
    scenes: Iterable[tuple[str, Scene]], planes: FocalPlanes, n_points: int, device: torch.device
) -> list[Row]:
    """How far truths are from the mean over very many points of the aperture.

    Args:
        scenes: Names and scenes.
        planes: Of the truths.
        n_points: Points along a side of the aperture.
        device: Where they are rendered.

    Returns:
        Rows `scene, psnr_db, worst_plane`, the PSNR that of the worst plane.
    """
    rows: list[Row] = []
    for name, scene in scenes:
        layers = bitmaps.paint(scene, device, float(planes.slopes.abs().max()))
        brute = [through_points(layers, scene.camera, slope, n_points) for slope in planes.slopes.tolist()]
        quality = psnr(truth.stack(layers, scene.camera, planes.slopes), torch.stack(brute))
        worst = int(quality.argmin())
        rows.append({"scene": name, "psnr_db": float(quality[worst]), "worst_plane": planes.labels[worst]})
    return rows


def through_points(layers: Sequence[Layer], camera: Camera, slope: float, n_points: int) -> Tensor:
    """A plane as the mean of pictures through points of the aperture, none of them blurred.

    Args:
        layers: From far to near, painted for a reach of |slope|.
        camera: The lens and the size of the picture.
        slope: Of the plane in pixels per view step.
        n_points: Points along each side of the square about the aperture.

    Returns:
        Picture, [3, H, W].
    """
    shares = (torch.arange(n_points, dtype=torch.float64) + 0.5) / n_points - 0.5
    total, count = torch.zeros(3, *camera.size, dtype=torch.float64), 0
    for share in shares:
        p = shares[torch.hypot(shares, share) <= 0.5] if camera.aperture == "disc" else shares
        pictures = render.render_views(layers, camera, p * camera.grid[1], share[None] * camera.grid[0], slope)
        total, count = total.to(pictures.device) + pictures[0].double().sum(0), count + len(p)
    return (total / count).float()
