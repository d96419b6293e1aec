"""Methods evaluated against a reference stack: sources of the reference, a row per plane, and means of the rows.

A simulated scene has the truth, the picture of a lens. A capture of many views has its dense integral, which a method
that gets only every second or third view should reproduce. Any other light field has exact Fourier refocusing of its
own views: that measures how an operator forms the sum, not how good the picture is. Views are decoded to linear light,
and pictures are compared as a screen gets them, encoded by the same curve.

Hold-out views. Along one axis, in dense view steps from the centre, D dense views have cells of width 1 and span
[-D/2, D/2]. Every `step`-th view, n of them, has a cell of width `step`. The cells at the ends, at `step` (n - 1)/2,
reach beyond D/2; their weight is the share of the cell inside D/2, so that both apertures are equal:

    share = (D/2 - step (n - 1)/2 + step/2) / step

Every second of 9 views makes 5 views, at -4 to 4: share = (4.5 - 4 + 1) / 2 = 3/4.

Letters: `V U` view rows and columns, `N` planes, `D` dense views along an axis.
"""

import functools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import pandas as pd
import torch
from torch import Tensor

from lfref.bench import accuracy
from lfref.bench.accuracy import EXACT, MEASURES, WHOLE, DisplayedStack, Row
from lfref.captures.correct import AUTO, correct
from lfref.encoding import LINEAR, Encoding
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes, even_planes
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.scene import analyze_scene
from lfref.refocus.shift.shift_and_sum_antialiased import cell_widths
from lfref.refocuser.refocuser import Aperture, OperatorRefocuser, Refocuser
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import developed, simulate, white_picture

IDEAL, SENSOR, CORRECTED, WIDE, ALIASED = "ideal", "sensor", "corrected", "wide", "aliased"
"""Classes of scenes in the tables: without a sensor; with one; the latter corrected; with views far apart; and with
textures and edges that alias, as photographs have them, without a sensor."""
CAPTURE, HOLD_OUT, GIVEN = "capture", "hold_out", "given"
"""Classes of light fields in the tables: all views, without a known truth; some of them, the others held out; all
views, with a truth that was given. The held-out views are evidence of the second rank: they know edges no better than
views do, and misrank methods there."""
N_WIDE_PLANES = 8
TRUTH, DENSE = "truth", "dense_integral"
APERTURES: dict[str, Aperture | None] = {"square": None, "disc": apertures.disc}
"""Shape of a camera's aperture -> weights of the views; None: all alike."""
EVEN_GRID = "methods are compared on an even grid"
"""Reason why corrections leave the cameras on the even grid: some methods read no other positions."""
CORRECTIONS = ("none", "auto", "flat_field")
"""Corrections of scenes with a sensor: none; from the views alone; with its picture of a white scene."""


@dataclass(frozen=True, eq=False)
class EvaluationCase:
    """A light field and the stack that methods should compute from it."""

    kind: str
    """Class in the tables, such as `ideal`."""
    light: LightField
    reference: Tensor
    """Reference stack, [N, C, H, W], in linear light if the views are."""
    reference_name: str
    aperture: Aperture | None = None
    encoding: Encoding = LINEAR
    """Encoding of pictures for a screen; views that are not linear have it already."""
    planes: FocalPlanes | None = None
    """Planes of the reference; None: the planes that all cases share."""

    def stack(self, method: Refocuser, slopes: Tensor) -> Tensor:
        """The stack of a method at these slopes [N]; operators use the reference's aperture, networks have none."""
        return method.through(self.aperture)(self.light, slopes)

    def displayed(self, stack: Tensor) -> DisplayedStack:
        """A stack [N, C, H, W] of these views, or their reference, as a screen shows it."""
        stack = stack.cpu()
        if self.light.is_linear:
            return DisplayedStack(self.encoding.encode(stack), stack)
        return DisplayedStack(stack, self.encoding.decode(stack))


def ideal_case(scene: Scene, slopes: Tensor, device: torch.device, kind: str = IDEAL) -> EvaluationCase:
    """Views and truth of a scene without its sensor, the truth at these slopes [N]."""
    simulated = simulate(replace(scene, sensor=Sensor()), slopes=slopes)
    assert simulated.views is not None
    assert simulated.truth is not None
    light, aperture = LightField(simulated.views, scene.name), APERTURES[scene.camera.aperture]
    return EvaluationCase(kind, light.to(device), simulated.truth.to(device), TRUTH, aperture)


def scene_cases(
    scenes: Iterable[Scene], slopes: Tensor, device: torch.device, correction: str = "none"
) -> Iterator[EvaluationCase]:
    """Scenes with their truth, developed as views are: without a sensor, with one if they have it, and corrected."""
    for scene in scenes:
        ideal = ideal_case(scene, slopes, device)
        yield ideal
        if scene.sensor == Sensor():
            continue
        views, encoding = simulate(scene, outputs=("views",), slopes=[0.0]).views, scene.sensor.encoding
        assert views is not None
        light = LightField(encoding.decode(views), scene.name).to(device)
        truth = encoding.decode(developed(ideal.reference, scene.sensor))
        case = EvaluationCase(SENSOR, light, truth, TRUTH, ideal.aperture, encoding)
        yield case
        if correction != "none":
            white = white_picture(scene, light) if correction == "flat_field" else None
            yield replace(case, kind=CORRECTED, light=correct(light, AUTO, white, EVEN_GRID)[0])


def wide_cases(scenes: Iterable[Scene], device: torch.device) -> Iterator[EvaluationCase]:
    """Scenes with their truth at planes of their own, from the farthest to the nearest of their surfaces."""
    for scene in scenes:
        ends = [end for surface in scene.surfaces for end in surface.geometry.disparity_range(scene.camera.size)]
        planes = even_planes(N_WIDE_PLANES, min(ends), max(ends))
        yield replace(ideal_case(scene, planes.slopes, device, WIDE), planes=planes)


class AxisSplit(NamedTuple):
    """Views along one angular axis: dense ones for the reference, sparse ones for the methods."""

    dense: slice
    sparse: slice
    shares: Tensor
    """Weight of each sparse view, in (0, 1], float64, [n]."""


def split_axis(n_views: int, step: int) -> AxisSplit:
    """Keep every `step`-th view of an axis, as many as possible; sparse and dense views have the same centre."""
    n_sparse = (n_views - 1) // step + 1
    if step < 2 or n_sparse < 2:
        got, remedy = f"every {step} of {n_views}", "set angular_stride=2, and reader.angular_size to read more"
        raise InputError("every second view or fewer must be kept, and two at least", got=got, remedy=remedy)
    reach = (n_sparse - 1) * step
    # An odd rest of views has no common centre with the sparse ones: the last dense view is left out.
    start, odd = divmod(n_views - 1 - reach, 2)
    n_dense = n_views - odd
    shares = torch.ones(n_sparse, dtype=torch.float64)
    shares[[0, -1]] = (n_dense - reach + step) / (2 * step)
    return AxisSplit(slice(0, n_dense), slice(start, start + reach + 1, step), shares)


def hold_out_cases(fields: Iterable[LightField], step: int, slopes: Tensor) -> Iterator[EvaluationCase]:
    """Every `step`-th view of captures along both axes, by which slopes [N] count, beside the integral of all views."""
    integral = OperatorRefocuser(DENSE, dense_integral)
    for field in fields:
        rows, columns = (split_axis(n_views, step) for n_views in field.grid)
        weights = rows.shares[:, None] * columns.shares
        reference = integral(_select_views(field, rows.dense, columns.dense), slopes / step)
        light = _select_views(field, rows.sparse, columns.sparse)
        aperture = functools.partial(apertures.mask, rows=weights)
        yield EvaluationCase(HOLD_OUT, light, reference, DENSE, aperture)


def dense_integral(views: Tensor, slopes: Tensor) -> Tensor:
    """Exact refocusing of views [V, U, C, H, W] at slopes [N]; in planes far from all surfaces, views stand for cells.

    Far from focus, a sum of points would leave copies of edges: views are blurred by the distance from the middle.
    """
    boxes = cell_widths(slopes, analyze_scene(views).ends)
    planes = zip(slopes.tolist(), boxes.tolist(), strict=True)
    return torch.cat(
        [exact_fourier(views, [slope], fill_factor=1.0, disparity=slope - box) for slope, box in planes], -4
    )


def _select_views(field: LightField, rows: slice, columns: slice) -> LightField:
    weight = None if field.weight is None else field.weight[rows, columns]
    return replace(field, views=field.views[rows, columns], weight=weight)


SERIES = ["class", "method", "reference"]
"""Columns that tell one line of a plot from another."""
COLUMNS = [*MEASURES, *(WHOLE + name for name in MEASURES), "exact_psnr_db"]
"""Measures of a row; the last one is PSNR against exact Fourier refocusing of the same views."""


@torch.no_grad()
def evaluate(
    cases: Iterable[EvaluationCase], methods: Sequence[Refocuser], planes: FocalPlanes, margin: int
) -> Iterator[Row]:
    """Compare every method with the reference of every case: a row per plane, of its interior and whole frame.

    Fixed planes take no part in cases of other planes; `planes` are those of cases that have none of their own.
    """
    for case in cases:
        accuracy.check_margin(margin, case.light.size)
        own = case.planes or planes
        reference = case.displayed(case.reference)
        exact = case.displayed(case.stack(EXACT, own.slopes)).inside(margin).encoded
        for method in methods:
            if case.planes is not None and method.planes is not None:
                continue
            stack = case.displayed(case.stack(method, own.slopes))
            measures = accuracy.plane_measures(stack, reference, margin)
            measures["exact_psnr_db"] = psnr(stack.inside(margin).encoded, exact).tolist()
            names = {"class": case.kind, "scene": case.light.name, "method": method.name}
            names["reference"] = case.reference_name
            for plane, *values in zip(accuracy.plane_names(own), *measures.values(), strict=True):
                yield names | plane | dict(zip(measures, values, strict=True))


def by_plane(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over all scenes of a class; scenes of the class `wide` have no planes in common, and are left out."""
    return _means_and_worst(rows[rows["class"] != WIDE], [*SERIES, "alpha", "slope"], "worst_scene", "scene")


def by_scene(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over all planes of a scene."""
    return _means_and_worst(rows, [*SERIES, "scene"], "worst_slope", "slope")


def by_class(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over all scenes and planes of a class, beside the median and the worst scene and plane.

    `worst_psnr_db` is the mean PSNR of the worst scene; `worst_plane` names scene and slope of the worst single plane;
    `nonzero_...` are means without slope 0; `brightness_error` is the largest distance of a plane's brightness from 1.
    """
    rows = rows.assign(plane=rows["scene"] + rows["slope"].map(" at slope {:.3g}".format))
    planes, nonzero = (
        _means_and_worst(part, SERIES, "worst_plane", "plane").set_index(SERIES)
        for part in (rows, rows[rows["slope"] != 0])
    )
    scenes = _means_and_worst(by_scene(rows), SERIES, "worst_scene", "scene").set_index(SERIES)
    groups = rows.assign(brightness_error=(rows["brightness"] - 1).abs()).groupby(SERIES, sort=False)
    more = groups.agg(scenes=("scene", "nunique"), brightness_error=("brightness_error", "max"))
    own = planes.rename(columns={"worst_psnr_db": "worst_plane_db"})
    scenes["median_psnr_db"] = own["median_psnr_db"]
    scenes = scenes.join(own[["worst_plane_db", "worst_plane"]])
    scenes = scenes.join(nonzero[["psnr_db", "ssim"]].add_prefix("nonzero_")).join(accuracy.explained(rows, SERIES))
    return scenes.join(more).reset_index()


def _means_and_worst(table: pd.DataFrame, keys: list[str], name: str, source: str) -> pd.DataFrame:
    """Means (PSNR capped) and medians over groups of rows, the least PSNR, and the `source` of its row as `name`."""
    # A PSNR that is not a number is worse than any number.
    table = table.reset_index(drop=True).fillna({"psnr_db": -math.inf})
    groups = table.groupby(keys, sort=False, dropna=False)
    worst = table.loc[groups["psnr_db"].idxmin()]
    columns = {"worst_psnr_db": worst["psnr_db"].to_numpy(), name: worst[source].to_numpy()}
    in_db = [column for column in COLUMNS if column.endswith("psnr_db")]
    counted = accuracy.capped(table, *in_db).groupby(keys, sort=False, dropna=False)
    median = groups["psnr_db"].median()
    return counted[COLUMNS].mean().assign(**columns, median_psnr_db=median).reset_index()
