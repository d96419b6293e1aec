"""Gains of the shipped network over other methods: the tables of `learned.md`.

The first is read from the tables of `lfref bench`; for the others, scenes are simulated here.
"""

import dataclasses
import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

import lfref
from lfref.bench.evaluation import MEAN_CAP_DB
from lfref.functional.psnr import psnr
from lfref.geometry import planes_at_alphas
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocuser import networks
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser
from lfref.report import tables
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor

RUNS = Path(__file__).resolve().parents[1] / "runs" / "figures"
LEARNED = "learned"
CLIPPED = "bokeh"
"""Its lamps clip on its sensor, so that no method can know how bright they are."""
SHAPES = ("discs", "leaves", "floor", "dome", "deep", "crossing")
GRIDS = (3, 5, 6, 7, 8, 9, 11)
MARGIN = 24
IS_MITSUBA_INSTALLED = importlib.util.find_spec("mitsuba") is not None


def gains() -> Iterator[str]:
    """The network beside the best of all other methods, for each class of scenes."""
    yield (
        "| scenes | best rival | its PSNR, dB | learned, dB | gain | worst scene | worst alpha "
        "| Delta E 2000, rival and learned | brightness off by at most, rival and learned |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    methods = tables.read_table(RUNS / "bench" / "bench.csv")["method"].unique()
    rivals = [name for name in methods if name != LEARNED]
    for run, kind, title in (
        ("bench", "ideal", "sim30, thirty without a sensor"),
        ("bench", "aliased", "sim30, aliased, thirty without a sensor"),
        ("bench", "corrected", "sim30, seven with a sensor, corrected"),
        ("varied", "ideal", "drawn at random, without a sensor"),
        ("varied", "corrected", "drawn at random, with a sensor, corrected"),
    ):
        rows = tables.read_table(RUNS / run / "evaluation.csv")
        rows = rows[rows["class"] == kind]
        yield _gain(title, rows[rows["scene"] != CLIPPED] if kind == "corrected" else rows, rivals)


def _gain(title: str, rows: pd.DataFrame, rivals: list[str]) -> str:
    """One class of scenes: means, and where the network gains least."""
    psnr_db, delta_e, brightness = (
        rows.pivot(index=["scene", "alpha"], columns="method", values=name)
        for name in ("psnr_db", "delta_e", "brightness")
    )
    psnr_db = psnr_db.clip(upper=MEAN_CAP_DB)
    best = psnr_db[[name for name in rivals if name in psnr_db]].mean().idxmax()
    gains = psnr_db[LEARNED] - psnr_db[best]
    scenes, alphas = (gains.groupby(level).mean() for level in ("scene", "alpha"))
    cells = [
        f"{title} ({len(scenes)})" if "random" in title else title,
        str(best),
        f"{psnr_db[best].mean():.2f}",
        f"{psnr_db[LEARNED].mean():.2f}",
        f"{gains.mean():+.2f}",
        f"{scenes.min():+.2f} ({scenes.idxmin()})",
        f"{alphas.min():+.2f} ({alphas.idxmin():g})",
        " and ".join(f"{delta_e[name].mean():.3f}" for name in (best, LEARNED)),
        " and ".join(f"{(brightness[name] - 1).abs().max():.4f}" for name in (best, LEARNED)),
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
        scenes = (_resampled(name, grid, ratio) for name in SHAPES)
        means = torch.stack([_rival_and_network(scene, slopes * ratio) for scene in scenes]).mean((0, 2))
        for cells, value in zip(rows.values(), means.tolist(), strict=True):
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
            if field.name == "gradient"
            else ratio * getattr(geometry, field.name)
        )
        for field in dataclasses.fields(geometry)  # type: ignore[arg-type]
        if field.name in ("disparity", "gradient", "bulge")
    }
    return dataclasses.replace(geometry, **scaled)  # type: ignore[type-var]


def _rival_and_network(scene: sim30.Scene, slopes: Tensor) -> Tensor:
    """PSNR of the rival and of the network, [2, N]."""
    simulated = lfref.simulate(scene, outputs=("views", "truth"), slopes=slopes)
    inner = (..., slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
    methods: tuple[Refocuser, ...] = (OperatorRefocuser("rival", occlusion_aware), lfref.load())
    stacks = [method(LightField(simulated.views), slopes) for method in methods]
    return torch.stack([psnr(stack[inner], simulated.truth[inner]) for stack in stacks])


def paths() -> Iterator[str]:
    """Gain on views and pictures that Mitsuba traced, by scene and slope."""
    from mitsuba_scenes import SCENES, SLOPES, MitsubaScene

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


def cards() -> Iterator[str]:
    """The model card, as the file of the weights holds it."""
    contents = checkpoint.read(networks.SHIPPED["learned"])
    notes = contents["notes"]
    n_weights = sum(value.numel() for value in contents["state_dict"].values())
    rows = {
        "what it does": notes["card"]["use"],
        "weights": f"{n_weights:,}, {networks.SHIPPED['learned'].stat().st_size / 1e6:.1f} MB",
        "data": notes["card"]["data"],
        "trained on": notes["card"]["trained_on"],
        "light fields, steps": f"{notes['fields']}, {notes['steps']:,}",
        "command": f"`{notes['command']}`",
        "gain on light fields held out": f"{notes['gain_db']:.2f} dB",
        "limits": notes["card"]["limits"],
        "licence of the weights": notes["card"]["licence"],
    }
    yield "| network | `learned` |"
    yield "|---|---|"
    for title, cell in rows.items():
        yield f"| {title} | {cell} |"


TABLES: dict[str, Callable[[], Iterator[str]]] = {"learned": gains, "learned_grids": grids, "cards": cards} | (
    {"learned_paths": paths} if IS_MITSUBA_INSTALLED else {}
)
