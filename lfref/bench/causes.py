"""Error causes: the cost of each in decibels, and the decibels that each remedy wins back.

Letters: T truth, the picture of a lens through its whole aperture; Q the mean of the lens's pictures through the points
of the views, without interpolation between pixels; X exact Fourier refocusing of the views, L linear shift-and-sum.
T -> Q -> X -> L adds one error after the other, so that each can be measured alone:

| cause | picture with it | without it | alone |
|---|---|---|---|
| points: the aperture is sampled by points | X | X - (Q - T) | Q against T |
| pixels: views are pixels, and edges near focus alias | X | Q | X against Q |
| interpolation, linear | L | X | L against X |
| border: the whole frame, not the interior | X | X in the interior | |
| an effect of the sensor | X of views with it | X | that against X, developed alike |
| fewer or more views over the same aperture | X of them | X | |
| range: all disparities doubled, but not the planes | X of that | X | |

`cost_db` is PSNR against the truth without the cause minus PSNR with it; below 0 the change is for the better. PSNR is
capped at 70 dB in means. `alone_db` is PSNR of the picture with the cause as its
only error. `won_db` is PSNR of another method on the same views minus PSNR of the picture with the cause. With an
effect of the sensor, the truth is developed like the views, and a tone curve stays: its cost is that of averaging
encoded values, as `encoding=none` does. With n instead of m views along the aperture, disparities and slopes are m/n
times as large, so that planes keep their places in the scene; this is measured where all surfaces are planes.
"""

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import pandas as pd
import torch
from torch import Tensor

from lfref import encoding
from lfref.bench import accuracy, evaluation
from lfref.bench.accuracy import EXACT, Row
from lfref.bench.evaluation import SENSOR, TRUTH, EvaluationCase
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser
from lfref.simulator import painting
from lfref.simulator import views as render
from lfref.simulator.effects import sensor as sensors
from lfref.simulator.effects.sensor import EFFECTS, Sensor
from lfref.simulator.layers import Layer
from lfref.simulator.scene import Camera, Scene
from lfref.simulator.simulate import developed
from lfref.simulator.surfaces import Plane

LINEAR = OperatorRefocuser("shift_and_sum", shift_and_sum)
MEASURES = ["psnr_db", "cost_db", "alone_db", "won_db"]


@dataclass(frozen=True)
class CauseSettings:
    """Settings of the measurement of every scene."""

    planes: FocalPlanes
    margin: int
    """Width of the border outside the interior, in pixels."""
    sensor: Sensor
    """Sensor whose effects are switched on one by one."""
    grids: tuple[int, ...]
    """Other numbers of views along both axes of the aperture."""
    device: torch.device


@dataclass(frozen=True, eq=False)
class Condition:
    """Views that suffer from a cause, with their truth."""

    cause: str
    case: EvaluationCase
    base: Refocuser
    """Method with which remedies are compared."""
    without_db: Tensor
    """PSNR of the base without the cause, [N]."""
    slopes: Tensor
    """Slopes of the truth's planes, in pixels per view step, [N]."""
    margin: int
    alone_db: Tensor | None = None
    """PSNR of the picture whose only error the cause is, [N]."""

    def psnr(self, method: Refocuser) -> Tensor:
        """PSNR of a method against the truth at every plane, in dB, [N]."""
        return _interior_psnr(self.case.stack(method, self.slopes), self.case.reference, self.margin)


def _interior_psnr(stack: Tensor, reference: Tensor, margin: int) -> Tensor:
    return psnr(accuracy.without_border(stack, margin), accuracy.without_border(reference, margin)).cpu()


@torch.no_grad()
def rows(scenes: Iterable[Scene], remedies: Sequence[Refocuser], settings: CauseSettings) -> Iterator[Row]:
    """Measure every cause, and what each remedy wins back, on scenes through square apertures: a row per plane."""
    for scene in scenes:
        accuracy.check_margin(settings.margin, scene.camera.size)
        for condition in _conditions(replace(scene, sensor=Sensor()), settings):
            base_db = condition.psnr(condition.base)
            cost_db, alone_db = condition.without_db - base_db, condition.alone_db
            alone_db = torch.full_like(base_db, torch.nan) if alone_db is None else alone_db
            for method in (condition.base, *remedies):
                is_base = method is condition.base
                method_db = base_db if is_base else condition.psnr(method)
                names = {"cause": condition.cause, "scene": scene.name, "method": method.name, "is_base": is_base}
                measures = [values.tolist() for values in (method_db, cost_db, alone_db, method_db - base_db)]
                for plane, *values in zip(accuracy.plane_names(settings.planes), *measures, strict=True):
                    yield names | plane | dict(zip(MEASURES, values, strict=True))


def _conditions(scene: Scene, settings: CauseSettings) -> Iterator[Condition]:
    if scene.camera.aperture != "square":
        raise InputError("error causes are measured through square apertures", got=f"a disc in {scene.name}")
    slopes, margin, device = settings.planes.slopes, settings.margin, settings.device
    interior_psnr = functools.partial(_interior_psnr, margin=margin)
    ideal = evaluation.ideal_case(scene, slopes, device)
    truth, exact, linear = ideal.reference, ideal.stack(EXACT, slopes), ideal.stack(LINEAR, slopes)
    exact_db = interior_psnr(exact, truth)

    # Sampling: by points of the aperture, by pixels, between pixels, at the border.
    layers, n_views = painting.paint(scene, float(slopes.abs().max())), max(scene.camera.grid)
    pictures = [through_points(layers, scene.camera, slope, n_views) for slope in slopes.tolist()]
    points = torch.stack(pictures).to(device)
    points_db = interior_psnr(points, truth)
    without_points_db = interior_psnr(exact - (points - truth), truth)
    yield Condition("points", ideal, EXACT, without_points_db, slopes, margin, points_db)
    yield Condition("pixels", ideal, EXACT, points_db, slopes, margin, interior_psnr(exact, points))
    yield Condition("interpolation", ideal, LINEAR, exact_db, slopes, margin, interior_psnr(linear, exact))
    yield Condition("border", ideal, EXACT, exact_db, slopes, margin=0)

    for name in EFFECTS:
        if (effect := getattr(settings.sensor, name)) is None:
            continue
        sensor = Sensor(**{name: effect})
        views = sensors.recorded(ideal.light.views, sensor, scene.seed)
        light = LightField(views, ideal.light.name, is_linear=sensor.encoding == encoding.LINEAR)
        case = EvaluationCase(SENSOR, light, developed(truth, sensor), TRUTH, encoding=sensor.encoding)
        alone_db = interior_psnr(case.stack(EXACT, slopes), developed(exact, sensor))
        yield Condition(name, case, EXACT, exact_db, slopes, margin, alone_db)

    if not all(isinstance(surface.geometry, Plane) for surface in scene.surfaces):
        return
    for n in settings.grids:
        factor = max(scene.camera.grid) / n
        case = evaluation.ideal_case(scaled(scene, factor, (n, n)), factor * slopes, device)
        yield Condition(f"{n}x{n} views", case, EXACT, exact_db, factor * slopes, margin)
    deep = evaluation.ideal_case(scaled(scene, 2.0, scene.camera.grid), slopes, device)
    yield Condition("range", deep, EXACT, exact_db, slopes, margin)


def through_points(layers: Sequence[Layer], camera: Camera, slope: float, n_points: int) -> Tensor:
    """The plane at a slope as the mean of pictures through `n_points` along each side of the aperture, [3, H, W]."""
    shares = (torch.arange(n_points, dtype=torch.float64) + 0.5) / n_points - 0.5
    total, count = torch.zeros(3, *camera.size, dtype=torch.float64), 0
    for share in shares:
        p = shares[torch.hypot(shares, share) <= 0.5] if camera.aperture == "disc" else shares
        pictures = render.render(layers, camera, p * camera.grid[1], share[None] * camera.grid[0], slope)
        total, count = total + pictures[0].double().sum(0), count + len(p)
    return (total / count).float()


def scaled(scene: Scene, factor: float, grid: tuple[int, int]) -> Scene:
    """A scene of planes with all disparities times `factor`, seen by another grid of views (rows, columns)."""
    surfaces = []
    for surface in scene.surfaces:
        assert isinstance(surface.geometry, Plane)
        gradient_x, gradient_y = surface.geometry.gradient
        plane = Plane(factor * surface.geometry.disparity, (factor * gradient_x, factor * gradient_y))
        surfaces.append(replace(surface, geometry=plane))
    return replace(scene, surfaces=tuple(surfaces), camera=replace(scene.camera, grid=grid))


def summary(rows: pd.DataFrame, *keys: str) -> pd.DataFrame:
    """Means of `rows`, PSNR capped, over scenes, and over planes unless `keys` name their columns."""
    counted = accuracy.capped(rows, "psnr_db", "alone_db")
    groups = counted.groupby(["cause", "method", "is_base", *keys], sort=False, dropna=False)
    return groups[MEASURES].mean().assign(scenes=groups["scene"].nunique()).reset_index()
