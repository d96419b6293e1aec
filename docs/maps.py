"""Errors of disparity maps, and of pictures from crosshairs and diagonals of views against whole apertures.

Tables of `refocusing.md` and `captures.md`, on scenes of sim30. Letters: `v u` view row and column.
"""

import functools
import importlib.util
import math
from collections.abc import Callable, Iterable, Iterator

import torch
from torch import Tensor

import lfref
from lfref.functional.psnr import psnr
from lfref.lightfield import LightField
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.simulate import Simulated

WIDE, TRACED = 24, 12  # pixels of a border
SURE = 0.5  # confidence
SHAPES = ("discs", "leaves", "floor", "dome", "deep", "crossing")  # scenes whose aperture is missing views
SLOPES = torch.tensor([-7.0, -2.0, -0.6, 0.0, 0.5, 1.2], dtype=torch.float64)
METHODS = {
    "shift_and_sum_through_cells": lfref.shift_and_sum_through_cells,
    "shift_and_sum, cubic": functools.partial(lfref.shift_and_sum, interpolation="cubic"),
    "disparity_layers": functools.partial(lfref.refocus_by_layers, fill=1.0),
    "occlusion_aware": occlusion_aware,
}


def disparities() -> Iterator[str]:
    """Errors of `disparity_map` over sim30: all scenes, those without a sensor, and the worst four."""
    errors = {name: _errors(name) for name in sim30.SCENES}
    plain = [name for name in errors if sim30.SCENES[name].sensor == Sensor()]
    yield "| scenes | median, px | within .03 px, % | within .1 px, % | within .1 px without a border of 24, % |"
    yield "|---|---|---|---|---|"
    for title, names in {"all thirty": list(errors), "without a sensor": plain}.items():
        yield _row(f"{title} ({len(names)})", [_shares(errors[name]) for name in names])
    for name in sorted(errors, key=lambda name: _shares(errors[name])[2])[:4]:
        yield _row(f"`{name}`", [_shares(errors[name])])


def _errors(name: str) -> Tensor:
    simulated = lfref.simulate(sim30.SCENES[name], outputs=("views", "disparity"))
    return (lfref.disparity_map(simulated.views).disparity - simulated.disparity).abs()


def _shares(errors: Tensor) -> list[float]:
    inside = errors[WIDE:-WIDE, WIDE:-WIDE]
    return [
        float(errors.median()),
        *(100 * float((part < far).float().mean()) for part, far in ((errors, 0.03), (errors, 0.1), (inside, 0.1))),
    ]


def _row(title: str, shares: list[list[float]]) -> str:
    median, *within = torch.tensor(shares).mean(0).tolist()
    return f"| {title} | {median:.4f} | {' | '.join(f'{share:.1f}' for share in within)} |"


def wide_disparities() -> Iterator[str]:
    """Range of slopes that `lfref info` finds on scenes of wide baselines, and errors of `disparity_map`."""
    yield "| scene | disparities, px | range found | covers, % | times as wide | median error, px | BadPix(.07), % |"
    yield "|---|---|---|---|---|---|---|"
    for name, scene in sim30.WIDE.items():
        simulated = lfref.simulate(scene, outputs=("views", "disparity"))
        truth = simulated.disparity
        low, high = lfref.inspect(LightField(simulated.views)).slopes or (math.nan, math.nan)
        ends = float(truth.min()), float(truth.max())
        covers = 100 * float(((truth >= low) & (truth <= high)).float().mean())
        errors = (lfref.disparity_map(simulated.views).disparity - truth).abs()[WIDE:-WIDE, WIDE:-WIDE]
        cells = [name, f"{ends[0]:g} to {ends[1]:g}", f"{low:.1f} to {high:.1f}", f"{covers:.1f}"]
        cells += [f"{(high - low) / (ends[1] - ends[0]):.2f}", f"{float(errors.median()):.3f}"]
        yield f"| {' | '.join([*cells, f'{100 * float((errors > 0.07).float().mean()):.1f}'])} |"
    yield ""
    yield f"BadPix(.07): share of pixels off by more than .07 px per view step, without {WIDE} px of the border."


def traced_disparities() -> Iterator[str]:
    """Errors of `disparity_map` on scenes that Mitsuba traces, and of those pixels that it is sure of."""
    import traced

    yield "| scene | disparities, px | median error, px | BadPix(.07), % | sure, % | BadPix(.07) of these, % |"
    yield "|---|---|---|---|---|---|"
    for name in traced.SCENES:
        truth, found = traced.disparity(name), lfref.disparity_map(traced.views(name).views)
        inside = (..., slice(TRACED, -TRACED), slice(TRACED, -TRACED))
        errors, is_sure = (found.disparity - truth).abs()[inside], found.confidence[inside] > SURE
        shares = [errors > 0.07, is_sure, errors[is_sure] > 0.07]
        cells = [f"{float(truth.min()):.1f} to {float(truth.max()):.1f}", f"{float(errors.median()):.3f}"]
        cells += [f"{100 * float(share.float().mean()):.1f}" for share in shares]
        yield f"| {name} | {' | '.join(cells)} |"
    yield ""
    yield f"7x7 views of 192x256, {TRACED} px of the border left out; sure: confidence above {SURE:g}."


def missing_views() -> Iterator[str]:
    """PSNR of pictures from part of the views against those of the whole aperture's truth."""
    steps = torch.arange(7)
    v, u = steps[:, None], steps
    apertures: dict[str, Tensor] = {
        "all 49": torch.ones(7, 7),
        "without corners (45)": 1.0 * ~((v % 6 == 0) & (u % 6 == 0)),
        "diagonals (13)": 1.0 * ((v == u) | (v == 6 - u)),
        "crosshair (13)": 1.0 * ((v == 3) | (u == 3)),
    }
    scenes = {name: lfref.simulate(sim30.SCENES[name], outputs=("views", "truth"), slopes=SLOPES) for name in SHAPES}
    yield f"| method | {' | '.join(apertures)} |"
    yield f"|---|{'---|' * len(apertures)}"
    for method, operator in METHODS.items():
        cells = [f"{_quality(operator, weights, scenes.values()):.1f}" for weights in apertures.values()]
        yield f"| {method} | {' | '.join(cells)} |"


def _quality(operator: Callable[..., Tensor], weights: Tensor, scenes: Iterable[Simulated]) -> float:
    refocuser = OperatorRefocuser("method", operator)
    psnr_db = []
    for scene in scenes:
        weight = weights[..., None, None, None].expand(*weights.shape, 1, *scene.views.shape[-2:]).contiguous()
        stack = refocuser(LightField(scene.views * weight, weight=weight), SLOPES)
        psnr_db.append(psnr(stack, scene.truth).mean())
    return float(torch.stack(psnr_db).mean())


TABLES: dict[str, Callable[[], Iterator[str]]] = {
    "disparities": disparities,
    "wide_disparities": wide_disparities,
    **({"traced_disparities": traced_disparities} if importlib.util.find_spec("mitsuba") else {}),
    "missing_views": missing_views,
}
