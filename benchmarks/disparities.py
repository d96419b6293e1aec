"""Errors of disparity maps over sim30: a table of `refocusing.md`."""

import math
from collections.abc import Callable, Iterator

from torch import Tensor

import lfref
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor

WIDE = 24  # pixels of a border


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
    median, *within = (sum(column) / len(shares) for column in zip(*shares, strict=True))
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


TABLES: dict[str, Callable[[], Iterator[str]]] = {"disparities": disparities, "wide_disparities": wide_disparities}
