"""Costs of the simulator, pass by pass, and the distance of refocused views from the truth.

A planned simulation runs only the passes that change a result, a forced one runs all. Distances are measured where
every view covers every pixel.
Letters: `N` planes, `H W` height and width.
"""

import functools
import itertools
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from lfref.bench import accuracy, evaluation, timing
from lfref.bench.accuracy import Row
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes, Slopes
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator import painting, truth
from lfref.simulator import views as render
from lfref.simulator.layers import Layer
from lfref.simulator.scene import Camera, Scene
from lfref.simulator.scenes import Scenes
from lfref.simulator.simulate import simulate


def costs(
    scenes: Mapping[str, Scene], slopes: Slopes, device: torch.device, rounds: Iterable[int], warmup: int = 1
) -> list[Row]:
    """Time planned against forced simulation of every scene (by class), all in turns; the first rounds warm up.

    Returns:
        Rows `scene, output, planned_s, forced_s, forced_over_planned` with medians in seconds.
    """
    watches = {}
    for name, output, is_forced in itertools.product(scenes, ("views", "truth"), (False, True)):
        run = functools.partial(
            simulate, scenes[name], outputs=(output,), slopes=slopes, force=is_forced, device=device
        )
        watches[name, output, is_forced] = functools.partial(timing.seconds, run, device)
    median = {key: statistics.median(times) for key, times in timing.in_turns(watches, rounds, warmup).items()}
    rows: list[Row] = []
    for name, output in itertools.product(scenes, ("views", "truth")):
        planned, forced = median[name, output, False], median[name, output, True]
        times = {"planned_s": planned, "forced_s": forced, "forced_over_planned": forced / planned}
        rows.append({"scene": name, "output": output, **times})
    return rows


def passes(scenes: Mapping[str, Scene], slopes: Slopes, device: torch.device) -> list[Row]:
    """Time of every pass that runs for views and truth of scenes (by class).

    Returns:
        Rows `scene, pass, milliseconds, share`; the shares of a scene add up to 1.
    """
    rows: list[Row] = []
    for name, scene in scenes.items():
        run = functools.partial(simulate, scene, outputs=("views", "truth"), slopes=slopes, device=device)
        run()  # compiles
        times = {row.name: row.milliseconds for row in run(timed=True).rows if row.milliseconds is not None}
        total = sum(times.values())
        rows += [{"scene": name, "pass": step, "milliseconds": ms, "share": ms / total} for step, ms in times.items()]
    return rows


@dataclass(eq=False)
class RandomPatches(Dataset[int]):
    """Simulates random scenes one by one, for the workers of a data loader; the results are dropped."""

    scenes: Scenes
    n_scenes: int
    outputs: tuple[str, ...]
    slopes: Tensor
    device: torch.device

    def __len__(self) -> int:
        return self.n_scenes

    def __getitem__(self, index: int) -> int:
        simulate(self.scenes.scene(0, 0, index), outputs=self.outputs, slopes=self.slopes, device=self.device)
        return index


def rates(scenes: Scenes, n_scenes: int, slopes: Tensor, device: torch.device, n_workers: int = 0) -> list[Row]:
    """Random scenes of the size of a patch simulated per second, after the first ones.

    Args:
        scenes: Source of the scenes.
        n_scenes: Number of scenes.
        slopes: Slopes of the truth's planes, [N].
        device: Device for rendering.
        n_workers: Number of processes of one thread that share the scenes; 0: this process, with all its threads.

    Returns:
        Rows `output, n_scenes, n_workers, per_second`.
    """
    n_first = 4 * max(1, n_workers)  # workers run a few scenes ahead
    rows: list[Row] = []
    for outputs in (("views",), ("views", "truth")):
        patches = RandomPatches(scenes, n_first + n_scenes, outputs, slopes, device)
        batches = iter(DataLoader(patches, batch_size=None, num_workers=n_workers))
        for _ in range(n_first):
            next(batches)
        per_second = n_scenes / timing.seconds(functools.partial(list, batches), device)
        names = {"output": " and ".join(outputs), "n_scenes": n_scenes, "n_workers": n_workers}
        rows.append(names | {"per_second": per_second})
    return rows


@torch.no_grad()
def distances(
    scenes: Iterable[tuple[str, Scene]], methods: Sequence[Refocuser], planes: FocalPlanes, device: torch.device
) -> list[Row]:
    """PSNR of refocused views against the truth, in linear light and without the sensor's effects.

    Returns:
        Rows `scene, method, alpha, slope, psnr_db`.
    """
    rows: list[Row] = []
    for name, scene in scenes:
        case = evaluation.ideal_case(scene, planes.slopes, device)
        reference = case.reference.cpu()
        for method in methods:
            stack = method(case.light.views, planes.slopes).cpu()
            # Plane by plane: the interior of one is larger than that of all.
            for n, plane in enumerate(accuracy.plane_names(planes)):
                one = slice(n, n + 1)
                errors = accuracy.interior_errors(stack[one], reference[one], planes.slopes[one], scene.camera.grid)
                rows.append({"scene": name, "method": method.name} | plane | {"psnr_db": errors["psnr_db"]})
    return rows


def by_plane(rows: Iterable[Row]) -> pd.DataFrame:
    """Mean, median and worst PSNR of `distances` over scenes; in the mean, each counts by at most `MEAN_CAP_DB`.

    Returns:
        Columns `method, alpha, slope, mean_db, median_db, worst_db, worst_scene`.
    """
    table = pd.DataFrame(rows)
    table["mean_db"] = table["psnr_db"].clip(upper=evaluation.MEAN_CAP_DB)
    groups = table.groupby(["method", "alpha", "slope"], sort=False, dropna=False)
    worst = table["scene"][groups["psnr_db"].idxmin()].to_numpy()
    values = {"mean_db": ("mean_db", "mean"), "median_db": ("psnr_db", "median"), "worst_db": ("psnr_db", "min")}
    return groups.agg(**values).assign(worst_scene=worst).reset_index()


@torch.no_grad()
def aperture_errors(
    scenes: Iterable[tuple[str, Scene]], planes: FocalPlanes, n_points: int, device: torch.device
) -> list[Row]:
    """PSNR of truths against the mean over very many points of the aperture, `n_points` along a side.

    Returns:
        Rows `scene, psnr_db, worst_plane`; the PSNR is that of the worst plane.
    """
    rows: list[Row] = []
    for name, scene in scenes:
        layers = painting.paint(scene, device, float(planes.slopes.abs().max()))
        brute_force = [through_points(layers, scene.camera, slope, n_points) for slope in planes.slopes.tolist()]
        decibels = psnr(truth.stack(layers, scene.camera, planes.slopes), torch.stack(brute_force))
        worst = int(decibels.argmin())
        rows.append({"scene": name, "psnr_db": float(decibels[worst]), "worst_plane": planes.labels[worst]})
    return rows


def through_points(layers: Sequence[Layer], camera: Camera, slope: float, n_points: int) -> Tensor:
    """The plane at a slope as the mean of sharp pictures through points of the aperture, [3, H, W].

    Args:
        layers: Layers from far to near, painted for a reach of |slope|.
        camera: The lens and the size of the picture.
        slope: Slope in pixels per view step.
        n_points: Number of points along each side of the square about the aperture.
    """
    shares = (torch.arange(n_points, dtype=torch.float64) + 0.5) / n_points - 0.5
    total, count = torch.zeros(3, *camera.size, dtype=torch.float64), 0
    for share in shares:
        p = shares[torch.hypot(shares, share) <= 0.5] if camera.aperture == "disc" else shares
        pictures = render.render(layers, camera, p * camera.grid[1], share[None] * camera.grid[0], slope)
        total, count = total.to(pictures.device) + pictures[0].double().sum(0), count + len(p)
    return (total / count).float()
