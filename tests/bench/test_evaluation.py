"""Evaluation: the references of scenes and captures, a row per plane, and summaries that name the worst."""

import dataclasses
import math

import pandas as pd
import pytest
import torch

from lfref.bench import accuracy, evaluation
from lfref.bench.accuracy import DisplayedStack
from lfref.bench.evaluation import EvaluationCase
from lfref.encoding import LINEAR, SRGB
from lfref.functional.psnr import psnr
from lfref.geometry import planes_at_alphas
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.recording import Exposure, ToneCurve
from lfref.simulator.effects.recording import Noise as SensorNoise
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import developed, simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker, Flat, Noise

CPU = torch.device("cpu")
PLANES = planes_at_alphas((0.5, 2.0))  # slopes -1 and 0.5
SLOPES = torch.tensor([-1.0, 0.0], dtype=torch.float64)
SENSOR = Sensor(exposure=Exposure(0.5), noise=SensorNoise(1e-3), tone_curve=ToneCurve("srgb"))
SURFACES = (Surface(Plane(0.0), Checker(9.0)), Surface(Plane(0.5), Flat((0.9, 0.8, 0.1)), Disc(3)))
CLEAN = Scene(Camera((3, 3), (20, 24)), SURFACES, name="clean")
NOISY = dataclasses.replace(CLEAN, sensor=SENSOR, name="noisy")
SUM, EXACT = OperatorRefocuser("sum", shift_and_sum), OperatorRefocuser("exact", exact_fourier)


def test_a_scene_with_a_sensor_is_evaluated_without_and_with_it():
    cases = list(evaluation.scene_cases([CLEAN, NOISY], SLOPES, CPU))
    assert [(case.kind, case.light.name, case.reference_name) for case in cases] == [
        ("ideal", "clean", "truth"), ("ideal", "noisy", "truth"), ("sensor", "noisy", "truth"),
    ]  # fmt: skip
    clean = simulate(CLEAN, slopes=SLOPES)
    for case in cases[:2]:
        assert torch.equal(case.light.views, clean.views)
        assert torch.equal(case.reference, clean.truth)
    views = simulate(NOISY, outputs=["views"], slopes=[0.0]).views
    assert torch.equal(cases[2].light.views, SENSOR.encoding.decode(views))
    displayed = cases[2].displayed(cases[2].reference)
    torch.testing.assert_close(displayed.encoded, developed(clean.truth, SENSOR))
    assert torch.equal(displayed.linear, cases[2].reference)


@pytest.mark.parametrize(("correction", "least"), [("auto", 15.0), ("flat_field", 20.0)])
def test_corrections_bring_a_vignetted_scene_nearer_to_the_truth(correction, least):
    cases = list(evaluation.scene_cases([sim30.SCENES["vignetting"]], SLOPES, CPU, correction))
    assert [case.kind for case in cases] == ["ideal", "sensor", "corrected"]
    before, after = (psnr(case.stack(EXACT, SLOPES), case.reference) for case in cases[1:])
    assert float((after - before).min()) > least


def test_operators_refocus_a_disc_scene_through_a_disc():
    camera = dataclasses.replace(CLEAN.camera, aperture="disc", grid=(5, 5))
    (case,) = evaluation.scene_cases([dataclasses.replace(CLEAN, camera=camera)], SLOPES, CPU)
    stack = case.stack(EXACT, SLOPES)
    torch.testing.assert_close(stack, exact_fourier(case.light.views, SLOPES, weights=apertures.disc((5, 5))))
    assert float(psnr(stack[0], case.reference[0])) > 1 + float(psnr(EXACT(case.light, SLOPES)[0], case.reference[0]))


def test_scenes_of_wide_baselines_have_planes_of_their_own():
    near = dataclasses.replace(CLEAN, surfaces=(*SURFACES, Surface(Plane(1.5), Flat(), Disc(2))), name="near")
    cases = list(evaluation.wide_cases([CLEAN, near], CPU))
    assert [case.planes.values for case in cases] == [
        pytest.approx([0.5 * k / 7 for k in range(8)]),
        pytest.approx([1.5 * k / 7 for k in range(8)]),
    ]
    torch.testing.assert_close(cases[1].reference, simulate(near, slopes=cases[1].planes.slopes).truth)
    rows = pd.DataFrame(evaluation.evaluate(cases, [SUM], PLANES, 2))
    assert rows["slope"].tolist() == [*cases[0].planes.values, *cases[1].planes.values]
    assert evaluation.by_plane(rows).empty
    assert evaluation.by_class(rows)["class"].tolist() == ["wide"]


@pytest.mark.parametrize(
    ("n_views", "step", "dense", "places", "end"),
    [
        (9, 2, 9, [0, 2, 4, 6, 8], 3 / 4),
        (9, 3, 9, [1, 4, 7], 1),
        (14, 3, 13, [0, 3, 6, 9, 12], 2 / 3),
    ],
)
def test_kept_views_have_the_centre_and_the_aperture_of_all(n_views, step, dense, places, end):
    split = evaluation.split_axis(n_views, step)
    all_places = torch.arange(n_views, dtype=torch.float64)
    assert all_places[split.sparse].tolist() == places
    assert all_places[split.dense].mean() == all_places[split.sparse].mean()
    assert len(all_places[split.dense]) == dense
    assert split.shares.tolist() == pytest.approx([end, *[1] * (len(places) - 2), end])
    assert float(step * split.shares.sum()) == pytest.approx(dense)


HOLD_OUT_SLOPES = torch.tensor([-2.0, 0.5, 1.0], dtype=torch.float64)


@pytest.fixture(scope="module")
def scene():
    """9x9 views of a card before a wall, and the truth of the lens over all of them at half the slopes."""
    surfaces = (
        Surface(Plane(-0.6), Noise((0.4,) * 3, (0.25,) * 3)),
        Surface(Plane(0.3), Checker(7.0, (0.9, 0.5, 0.1), (0.1, 0.2, 0.3)), Disc(14)),
        Surface(Plane(0.6), Flat(), Disc(2, (20, 5))),
    )
    return simulate(Scene(Camera((9, 9), (72, 88)), surfaces), slopes=HOLD_OUT_SLOPES / 2)


def inner(stack):
    return stack[..., 12:-12, 12:-12]


def test_the_dense_integral_is_nearer_to_the_truth_than_the_kept_views(scene):
    (case,) = evaluation.hold_out_cases([LightField(scene.views, "capture")], 2, HOLD_OUT_SLOPES)
    assert (case.kind, case.reference_name, case.light.name) == ("hold_out", "dense_integral", "capture")
    torch.testing.assert_close(case.reference, exact_fourier(scene.views, HOLD_OUT_SLOPES / 2))
    torch.testing.assert_close(case.light.views, scene.views[::2, ::2])
    dense, sparse = (psnr(inner(it), inner(scene.truth)) for it in (case.reference, case.stack(SUM, HOLD_OUT_SLOPES)))
    assert float((dense - sparse)[0]) > 6  # far from focus, half the step leaves a quarter of the error
    # The weights of the views at the ends bring the sum nearer to truth and integral.
    cut, whole = case.stack(EXACT, HOLD_OUT_SLOPES), EXACT(case.light, HOLD_OUT_SLOPES)
    for reference in (scene.truth, case.reference):
        assert float((psnr(inner(cut), inner(reference)) - psnr(inner(whole), inner(reference))).min()) > 0.3


def random_case(kind, encoding=LINEAR):
    views, truth = torch.rand(3, 3, 3, 20, 24), torch.rand(2, 3, 20, 24)
    return EvaluationCase(kind, LightField(views, "a"), truth, "truth", encoding=encoding)


def test_there_is_a_row_for_every_plane_of_every_method_on_every_case():
    cases = [random_case("ideal"), random_case("sensor", SRGB)]
    rows = list(evaluation.evaluate(cases, [SUM, EXACT], PLANES, 4))
    assert [(row["class"], row["method"], row["alpha"]) for row in rows] == [
        (kind, method, alpha) for kind in ("ideal", "sensor") for method in ("sum", "exact") for alpha in (0.5, 2.0)
    ]
    stack = SUM(cases[1].light, PLANES.slopes)
    displayed = [DisplayedStack(SRGB.encode(light), light) for light in (stack, cases[1].reference)]
    for name, values in accuracy.plane_measures(*displayed, 4).items():
        assert [row[name] for row in rows[4:6]] == pytest.approx(values)
    pair = [SRGB.encode(it)[..., 4:-4, 4:-4] for it in (stack, EXACT(cases[1].light, PLANES.slopes))]
    assert [row["exact_psnr_db"] for row in rows[4:6]] == pytest.approx(psnr(*pair).tolist())


def table():
    """Two scenes and planes in one class, one of them in another."""
    rows = [
        ("ideal", "a", "sum", -1.0, 40.0, 1.001), ("ideal", "a", "sum", 0.5, 50.0, 0.995),
        ("ideal", "b", "sum", -1.0, 30.0, 1.0), ("ideal", "b", "sum", 0.5, 100.0, 1.0),
        ("ideal", "a", "net", -1.0, 20.0, 1.0), ("ideal", "a", "net", 0.5, 22.0, 1.0),
        ("sensor", "b", "sum", -1.0, 25.0, 1.0), ("sensor", "b", "sum", 0.5, 27.0, 1.0),
    ]  # fmt: skip
    columns = ["class", "scene", "method", "slope", "psnr_db", "brightness"]
    rest = {name: 0.5 for name in evaluation.COLUMNS if name not in columns}
    return pd.DataFrame(rows, columns=columns).assign(alpha=math.nan, reference="truth", **rest)


def cells(summary, *columns):
    return list(summary[[*columns]].itertuples(index=False, name=None))


def test_scenes_are_means_over_the_planes_and_a_psnr_that_is_no_number_is_the_worst():
    # In means, a PSNR counts by at most 70 dB.
    summary = evaluation.by_scene(table())
    assert cells(summary, "class", "method", "scene", "psnr_db", "worst_psnr_db", "worst_slope") == [
        ("ideal", "sum", "a", 45.0, 40.0, -1.0), ("ideal", "sum", "b", 50.0, 30.0, -1.0),
        ("ideal", "net", "a", 21.0, 20.0, -1.0), ("sensor", "sum", "b", 26.0, 25.0, -1.0),
    ]  # fmt: skip
    broken = table()
    broken.loc[1, "psnr_db"] = math.nan
    assert evaluation.by_scene(broken)["worst_psnr_db"][0] == -math.inf


def test_classes_are_means_over_all_and_name_the_worst_scene_and_brightness():
    summary = evaluation.by_class(table())
    assert cells(summary, "class", "method", "scenes", "psnr_db", "worst_psnr_db", "worst_scene") == [
        ("ideal", "sum", 2, 47.5, 45.0, "a"), ("ideal", "net", 1, 21.0, 21.0, "a"),
        ("sensor", "sum", 1, 26.0, 26.0, "b"),
    ]  # fmt: skip
    assert summary["brightness_error"].tolist() == pytest.approx([0.005, 0, 0])
    assert cells(summary, "median_psnr_db", "worst_plane_db", "worst_plane") == [
        (45.0, 30.0, "b at slope -1"), (21.0, 20.0, "a at slope -1"), (26.0, 25.0, "b at slope -1"),
    ]  # fmt: skip
