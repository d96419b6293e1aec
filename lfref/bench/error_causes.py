"""Where the decibels are: what each cause of error costs alone, and what each remedy wins back.

Letters: T truth, what a lens records through its whole aperture; Q the mean of its pictures through the views' points,
read nowhere between pixels; X exact Fourier refocusing of the views, L linear shift-and-sum. T -> Q -> X -> L is one
error after the other, so that each can be told alone:

| cause | picture with it | without it | alone |
|---|---|---|---|
| points: the aperture is sampled by points | X | X - (Q - T) | Q against T |
| pixels: views are pixels, and edges near focus alias | X | Q | X against Q |
| interpolation, linear | L | X | L against X |
| border: the whole frame, not the interior | X | X in the interior | |
| an effect of the sensor | X of views with it | X | that against X, developed alike |
| fewer or more views over the same aperture | X of them | X | |
| range: all disparities, those of the planes excepted, doubled | X of that | X | |

`cost_db` is PSNR against truth without the cause less that with it, all else as it was; below 0 the change is for the
better. PSNR is capped at 100 dB, and where nothing else is wrong, so is what a cause costs. `alone_db` is PSNR of the
picture whose only error it is. With a sensor's effect, the truth is developed like the views, and a tone curve is
left on: what it costs is the mean of encoded values, as `encoding=none` takes it. `won_db` is what another
method makes of the same views, against the same truth, less what the one above makes. Planes keep their places in the
scene: with n instead of m views along the aperture, disparities and slopes are m/n times as large. That is done where
all surfaces are planes.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import pandas as pd
import torch
from torch import Tensor

from lfref import encoding
from lfref.bench import accuracy, simulation_cost
from lfref.bench.accuracy import Row
from lfref.bench.evaluation import IDEAL, SENSOR, TRUTH, EvaluationCase
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator import bitmaps
from lfref.simulator.developed import developed
from lfref.simulator.effects import chain
from lfref.simulator.effects.sensor import EFFECTS, Sensor
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane

EXACT, LINEAR = OperatorRefocuser("exact_fourier", exact_fourier), OperatorRefocuser("shift_and_sum", shift_and_sum)
MEASURES = ["psnr_db", "cost_db", "alone_db", "won_db"]


@dataclass(frozen=True)
class Plan:
    """What is measured on every scene."""

    planes: FocalPlanes
    margin: int
    """Width in pixels of the border that the interior lacks."""
    sensor: Sensor
    """Its effects are switched on one by one."""
    grids: tuple[int, ...]
    """Other numbers of views along both axes of the aperture."""
    device: torch.device

    def quality(self, stack: Tensor, reference: Tensor) -> Tensor:
        """PSNR of every plane in the interior, in dB, [N]."""
        return _psnr(stack, reference, self.margin)


@dataclass(frozen=True, eq=False)
class Condition:
    """Views that suffer from a cause, with their truth."""

    cause: str
    subject: EvaluationCase
    base: Refocuser
    """What is taken of them; remedies are compared with it."""
    without_db: Tensor
    """PSNR of the base without the cause, [N]."""
    slopes: Tensor
    """Of the truth's planes, in pixels per view step, [N]."""
    margin: int
    alone_db: Tensor | None = None
    """PSNR of a picture that has no other error, [N]."""

    def psnr(self, method: Refocuser) -> Tensor:
        """How near a method comes to the truth at every plane, in dB, [N]."""
        return _psnr(self.subject.stack(method, self.slopes), self.subject.truth, self.margin)


def _psnr(stack: Tensor, reference: Tensor, margin: int) -> Tensor:
    height, width = stack.shape[-2:]
    window = (..., slice(margin, height - margin), slice(margin, width - margin))
    return psnr(stack[window], reference[window]).cpu()


@torch.no_grad()
def rows(scenes: Iterable[Scene], remedies: Sequence[Refocuser], plan: Plan) -> Iterator[Row]:
    """Measure every cause on every scene.

    Args:
        scenes: Through square apertures.
        remedies: Methods that might help.
        plan: What is measured.

    Yields:
        Rows `cause, scene, method, is_base, alpha, slope, psnr_db, cost_db, alone_db, won_db`, one a plane; slopes are
        those of the scene's own views.

    Raises:
        InputError: A round aperture, or pictures too small.
    """
    for scene in scenes:
        accuracy.check_margin(plan.margin, scene.camera.size)
        for condition in _conditions(dataclasses.replace(scene, sensor=Sensor()), plan):
            base = condition.psnr(condition.base)
            for method in (condition.base, *remedies):
                found = base if method is condition.base else condition.psnr(method)
                names = {"cause": condition.cause, "scene": scene.name, "method": method.name}
                values = _measured(condition, base, found)
                for place, *each in zip(accuracy.plane_names(plan.planes), *values, strict=True):
                    yield names | {"is_base": method is condition.base} | place | dict(zip(MEASURES, each, strict=True))


def _measured(condition: Condition, base: Tensor, found: Tensor) -> list[list[float]]:
    unknown = torch.full_like(found, torch.nan)
    alone = unknown if condition.alone_db is None else condition.alone_db
    return [values.tolist() for values in (found, condition.without_db - base, alone, found - base)]


def _conditions(scene: Scene, plan: Plan) -> Iterator[Condition]:
    if scene.camera.aperture != "square":
        raise InputError("causes are told apart through square apertures", got=f"a disc in {scene.name}")
    slopes = plan.planes.slopes
    ideal = _seen(scene, slopes, plan.device)
    exact = ideal.stack(EXACT, slopes)
    yield from _of_sampling(scene, ideal, exact, plan)
    for name in EFFECTS:
        if (effect := getattr(plan.sensor, name)) is not None:
            yield _of_effect(name, Sensor(**{name: effect}), ideal, exact, plan, scene.seed)
    if all(isinstance(surface.geometry, Plane) for surface in scene.surfaces):
        yield from _of_geometry(scene, plan.quality(exact, ideal.truth), plan)


def _of_sampling(scene: Scene, ideal: EvaluationCase, exact: Tensor, plan: Plan) -> Iterator[Condition]:
    """Points, pixels, interpolation and border."""
    slopes, truth = plan.planes.slopes, ideal.truth
    points = _through_points(scene, slopes, plan.device)
    as_it_is, linear = plan.quality(exact, truth), ideal.stack(LINEAR, slopes)

    without = plan.quality(exact - (points - truth), truth)
    yield Condition("points", ideal, EXACT, without, slopes, plan.margin, plan.quality(points, truth))
    without = plan.quality(points, truth)
    yield Condition("pixels", ideal, EXACT, without, slopes, plan.margin, plan.quality(exact, points))
    yield Condition("interpolation", ideal, LINEAR, as_it_is, slopes, plan.margin, plan.quality(linear, exact))
    yield Condition("border", ideal, EXACT, as_it_is, slopes, margin=0)


def _of_effect(name: str, sensor: Sensor, ideal: EvaluationCase, exact: Tensor, plan: Plan, seed: int) -> Condition:
    """One effect of the sensor, on views that have no other."""
    views = chain.recorded(ideal.light.views, sensor, seed)
    truth = developed(ideal.truth, sensor)
    light = LightField(views, ideal.light.name, is_linear=sensor.encoding == encoding.LINEAR)
    subject = EvaluationCase(SENSOR, light, truth, TRUTH, encoding=sensor.encoding)
    slopes = plan.planes.slopes
    without = plan.quality(exact, ideal.truth)
    alone = plan.quality(subject.stack(EXACT, slopes), developed(exact, sensor))
    return Condition(name, subject, EXACT, without, slopes, plan.margin, alone)


def _of_geometry(scene: Scene, as_it_is: Tensor, plan: Plan) -> Iterator[Condition]:
    """Other numbers of views, and a scene twice as deep."""
    slopes, n_views = plan.planes.slopes, max(scene.camera.grid)
    for n in plan.grids:
        factor = n_views / n
        seen = _seen(scaled(scene, factor, (n, n)), factor * slopes, plan.device)
        yield Condition(f"{n}x{n} views", seen, EXACT, as_it_is, factor * slopes, plan.margin)
    deep = _seen(scaled(scene, 2.0, scene.camera.grid), slopes, plan.device)
    yield Condition("range", deep, EXACT, as_it_is, slopes, plan.margin)


def _seen(scene: Scene, slopes: Tensor, device: torch.device) -> EvaluationCase:
    made = simulate(scene, slopes=slopes, device=device)
    assert made.views is not None
    assert made.truth is not None
    return EvaluationCase(IDEAL, LightField(made.views, scene.name), made.truth, TRUTH)


def _through_points(scene: Scene, slopes: Tensor, device: torch.device) -> Tensor:
    """Q: the mean of the lens's pictures through the points where the views are, [N, 3, H, W]."""
    layers = bitmaps.paint(scene, device, float(slopes.abs().max()))
    n_views = max(scene.camera.grid)
    return torch.stack(
        [simulation_cost.through_points(layers, scene.camera, slope, n_views) for slope in slopes.tolist()]
    )


def scaled(scene: Scene, factor: float, grid: tuple[int, int]) -> Scene:
    """A scene whose disparities are larger, seen by another grid of views.

    Args:
        scene: All its surfaces planes.
        factor: Of all disparities.
        grid: View rows and columns; with `factor` the old number over the new, the aperture is the same.
    """
    planes = [surface.geometry for surface in scene.surfaces if isinstance(surface.geometry, Plane)]
    larger = [Plane(factor * each.disparity, (factor * each.gradient[0], factor * each.gradient[1])) for each in planes]
    pairs = zip(scene.surfaces, larger, strict=True)
    surfaces = tuple(dataclasses.replace(surface, geometry=geometry) for surface, geometry in pairs)
    return dataclasses.replace(scene, surfaces=surfaces, camera=dataclasses.replace(scene.camera, grid=grid))


def summary(measured: pd.DataFrame, *keys: str) -> pd.DataFrame:
    """Means over scenes, and over planes unless they are among the keys.

    Args:
        measured: Of `rows`.
        *keys: More columns to keep apart, such as `alpha` and `slope`.

    Returns:
        Columns `cause, method, is_base, *keys, psnr_db, cost_db, alone_db, won_db, scenes`.
    """
    groups = measured.groupby(["cause", "method", "is_base", *keys], sort=False, dropna=False)
    return groups[MEASURES].mean().assign(scenes=groups["scene"].nunique()).reset_index()
