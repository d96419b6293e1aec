"""Measure what the shipped network gains over its rivals: the tables of `learned.md`.

Two of them are read from what `lfref bench` left; grids, slopes and paths are rendered here.
"""

import dataclasses
import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

import lfref
from lfref.functional.psnr import psnr
from lfref.geometry import planes_at_alphas
from lfref.lightfield import LightField
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Refocuser
from lfref.report import tables
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor

RUNS = Path(__file__).resolve().parents[1] / "runs" / "figures"
MOST_UNITS = 2.0
"""NumPy's 4-D FFTs that a rival may take."""
LEARNED = "learned"
CLIPPED = "bokeh"
"""Lamps that clip with its sensor: nobody can know how bright they are."""
SHAPES = ("discs", "leaves", "floor", "dome", "deep", "crossing")
GRIDS = (3, 5, 6, 7, 8, 9, 11)
MARGIN = 24
IS_MITSUBA_INSTALLED = importlib.util.find_spec("mitsuba") is not None


def gains() -> Iterator[str]:
    """The network beside the best rival of each class of scenes."""
    yield (
        "| scenes | best rival | its PSNR, dB | learned, dB | gain | worst scene | worst alpha "
        "| Delta E 2000, rival and learned | brightness off by at most, rival and learned |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    units = tables.read_table(RUNS / "bench" / "bench.csv").groupby("method")["ratio_to_numpy_fft"].first()
    rivals = [name for name, ratio in units.items() if name != LEARNED and ratio * MOST_UNITS >= 1]
    for run, kind, title in (
        ("bench", "ideal", "sim30, thirty without a sensor"),
        ("bench", "corrected", "sim30, seven with a sensor, corrected"),
        ("varied", "ideal", "drawn at random, without a sensor"),
        ("varied", "corrected", "drawn at random, with a sensor, corrected"),
    ):
        judged = tables.read_table(RUNS / run / "evaluation.csv")
        judged = judged[(judged["class"] == kind) & ~((kind == "corrected") & (judged["scene"] == CLIPPED))]
        yield _gain(title, judged, rivals)


def _gain(title: str, judged: pd.DataFrame, rivals: list[str]) -> str:
    """One class of scenes: means, and where the network gains least."""
    wide, delta, light = (
        judged.pivot(index=["scene", "alpha"], columns="method", values=name)
        for name in ("psnr_db", "delta_e", "brightness")
    )
    best = wide[[name for name in rivals if name in wide]].mean().idxmax()
    gained = wide[LEARNED] - wide[best]
    scenes, alphas = (gained.groupby(level).mean() for level in ("scene", "alpha"))
    n_scenes = len(scenes)
    cells = [
        f"{title} ({n_scenes})" if "random" in title else title,
        str(best),
        f"{wide[best].mean():.2f}",
        f"{wide[LEARNED].mean():.2f}",
        f"{gained.mean():+.2f}",
        f"{scenes.min():+.2f} ({scenes.idxmin()})",
        f"{alphas.min():+.2f} ({alphas.idxmin():g})",
        " and ".join(f"{delta[name].mean():.3f}" for name in (best, LEARNED)),
        " and ".join(f"{(light[name] - 1).abs().max():.4f}" for name in (best, LEARNED)),
    ]
    return f"| {' | '.join(cells)} |"


def grids() -> Iterator[str]:
    """Gain by the grid of views; 6x6, 8x8 and 11x11 were never trained on."""
    slopes = planes_at_alphas(step / 8 for step in range(1, 17)).slopes
    yield f"| views | {' | '.join(f'{n}x{n}' for n in GRIDS)} |"
    yield f"|---|{'---|' * len(GRIDS)}"
    rows: dict[str, list[str]] = {"occlusion_aware, dB": [], "learned, dB": []}
    for grid in GRIDS:
        # As wide an aperture, whatever the number of views.
        ratio = 6 / (grid - 1)
        found = torch.stack([_judged(_resampled(name, grid, ratio), slopes * ratio) for name in SHAPES]).mean((0, 2))
        for cells, value in zip(rows.values(), found.tolist(), strict=True):
            cells.append(f"{value:.1f}")
    for title, cells in rows.items():
        yield f"| {title} | {' | '.join(cells)} |"


def _resampled(name: str, grid: int, ratio: float) -> sim30.Scene:
    """A scene photographed by another grid of views through an aperture as wide."""
    scene = sim30.SCENES[name]
    surfaces = tuple(
        dataclasses.replace(surface, geometry=_scaled(surface.geometry, ratio)) for surface in scene.surfaces
    )
    camera = dataclasses.replace(scene.camera, grid=(grid, grid))
    return dataclasses.replace(scene, camera=camera, surfaces=surfaces, sensor=Sensor())


def _scaled(geometry: object, ratio: float) -> object:
    """Disparities by a view step of another length."""
    scaled = {
        field.name: (
            tuple(ratio * each for each in getattr(geometry, field.name))
            if field.name == "slant"
            else ratio * getattr(geometry, field.name)
        )
        for field in dataclasses.fields(geometry)  # type: ignore[arg-type]
        if field.name in ("disparity", "slant", "bulge")
    }
    return dataclasses.replace(geometry, **scaled)  # type: ignore[type-var]


def _judged(scene: sim30.Scene, slopes: Tensor) -> Tensor:
    """PSNR of the rival and of the network, [2, N]."""
    made = lfref.simulate(scene, outputs=("views", "truth"), slopes=slopes)
    inner = (..., slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
    methods: tuple[Refocuser, ...] = (OperatorRefocuser("rival", occlusion_aware), lfref.load())
    stacks = [method(LightField(made.views), slopes) for method in methods]
    return torch.stack([psnr(stack[inner], made.truth[inner]) for stack in stacks])


def paths() -> Iterator[str]:
    """Gain on views and pictures that Mitsuba traced, by scene and slope."""
    from lfref.simulator.mitsuba_scenes import SCENES, SLOPES, MitsubaScene

    yield f"| scene | {' | '.join(f'slope {slope:g}' for slope in SLOPES)} |"
    yield f"|---|{'---|' * len(SLOPES)}"
    methods: tuple[Refocuser, ...] = (OperatorRefocuser("rival", occlusion_aware), lfref.load())
    for scene in SCENES:
        world = MitsubaScene(scene("square"))
        views = torch.stack([torch.stack([world.view(u - 3, v - 3, samples=256) for u in range(7)]) for v in range(7)])
        truth = torch.stack([world.through_square(slope) for slope in SLOPES])
        inner = (..., slice(8, -8), slice(8, -8))
        rival, ours = (psnr(method(LightField(views), SLOPES)[inner], truth[inner]) for method in methods)
        cells = [f"{before:.1f} to {after:.1f}" for before, after in zip(rival.tolist(), ours.tolist(), strict=True)]
        yield f"| {scene.__name__} | {' | '.join(cells)} |"


TABLES: dict[str, Callable[[], Iterator[str]]] = {"learned": gains, "learned_grids": grids} | (
    {"learned_paths": paths} if IS_MITSUBA_INSTALLED else {}
)
