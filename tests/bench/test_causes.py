"""Error causes: each condition is the base with one thing changed, and its figures are differences of PSNR."""

import dataclasses
import math

import pandas as pd
import pytest
import torch

from lfref.bench import causes
from lfref.bench.causes import EXACT, LINEAR, CauseSettings
from lfref.functional.psnr import psnr
from lfref.geometry import planes_at_alphas
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.effects.optics import Crosstalk
from lfref.simulator.effects.recording import ToneCurve
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import developed, simulate
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Noise

PLANES = planes_at_alphas((0.5, 2.0))  # slopes -1 and 0.5
SENSOR = Sensor(crosstalk=Crosstalk(0.1), tone_curve=ToneCurve("srgb"))
SETTINGS = CauseSettings(PLANES, 5, SENSOR, (5,), torch.device("cpu"))
WALL = Surface(Plane(-0.5, (0.002, 0.0)), Noise((0.4,) * 3, (0.2,) * 3))
CARD = Surface(Plane(0.3), Checker(7.0), Disc(7))
SCENE = Scene(Camera((3, 3), (36, 40)), (WALL, CARD), name="card")
BULGE = dataclasses.replace(SCENE, surfaces=(WALL, Surface(Dome(0.1, 0.2, 8), Checker(5.0), Disc(8))), name="bulge")
CUBIC = OperatorRefocuser("cubic", lambda views, slopes: shift_and_sum(views, slopes, interpolation="cubic"))
SAMPLING = ["points", "pixels", "interpolation", "border"]
EFFECTS, GEOMETRY = ["crosstalk", "tone_curve"], ["5x5 views", "range"]


@pytest.fixture(scope="module")
def table():
    return pd.DataFrame(causes.rows([SCENE, BULGE], [CUBIC], SETTINGS))


@pytest.fixture(scope="module")
def simulated():
    return simulate(SCENE, slopes=PLANES.slopes)


def inner(stack, margin=5):
    return stack[..., margin : stack.shape[-2] - margin, margin : stack.shape[-1] - margin]


def near(stack, reference, margin=5):
    return psnr(inner(stack, margin), inner(reference, margin))


def of(table, cause, method, column):
    rows = table.query(f"cause == '{cause}' and method == '{method}' and scene == 'card'")
    return torch.tensor(rows[column].to_numpy(), dtype=torch.float32)


def test_geometry_is_changed_where_all_surfaces_are_planes(table):
    causes = table.groupby("scene", sort=False)["cause"].unique()
    assert causes["card"].tolist() == [*SAMPLING, *EFFECTS, *GEOMETRY]
    assert causes["bulge"].tolist() == [*SAMPLING, *EFFECTS]


def test_measures_are_psnr_against_the_truth(table, simulated):
    exact, linear, cubic = (method(simulated.views, PLANES.slopes) for method in (EXACT, LINEAR, CUBIC))
    truth = simulated.truth
    torch.testing.assert_close(of(table, "points", "exact_fourier", "psnr_db"), near(exact, truth))
    torch.testing.assert_close(of(table, "interpolation", "shift_and_sum", "psnr_db"), near(linear, truth))
    cost = near(exact, truth) - near(linear, truth)
    torch.testing.assert_close(of(table, "interpolation", "shift_and_sum", "cost_db"), cost)
    torch.testing.assert_close(of(table, "interpolation", "shift_and_sum", "alone_db"), near(linear, exact))
    won = near(cubic, truth) - near(linear, truth)
    torch.testing.assert_close(of(table, "interpolation", "cubic", "won_db"), won)
    whole = near(exact, truth) - near(exact, truth, margin=0)
    torch.testing.assert_close(of(table, "border", "exact_fourier", "cost_db"), whole)


def test_points_and_pixels_are_the_two_parts_of_the_error_of_exact_refocusing(table):
    # Without the points' error, what remains is that of the pixels alone; without the pixels', that of the points.
    psnr_db, alone, cost = (
        {cause: of(table, cause, "exact_fourier", column) for cause in ("points", "pixels")}
        for column in ("psnr_db", "alone_db", "cost_db")
    )
    torch.testing.assert_close(psnr_db["points"] + cost["points"], alone["pixels"], atol=1e-3, rtol=0)
    torch.testing.assert_close(psnr_db["pixels"] + cost["pixels"], alone["points"], atol=1e-3, rtol=0)
    assert float(cost["points"][0]) > 10  # whole slopes read nothing between pixels


def test_an_effect_of_the_sensor_is_compared_with_the_truth_developed_like_its_views(table, simulated):
    sensor = Sensor(tone_curve=SENSOR.tone_curve)
    views = simulate(dataclasses.replace(SCENE, sensor=sensor), outputs=["views"], slopes=[0.0]).views
    expected = near(EXACT(views, PLANES.slopes), developed(simulated.truth, sensor))
    torch.testing.assert_close(of(table, "tone_curve", "exact_fourier", "psnr_db"), expected)
    cost = near(EXACT(simulated.views, PLANES.slopes), simulated.truth) - expected
    torch.testing.assert_close(of(table, "tone_curve", "exact_fourier", "cost_db"), cost)


def test_means_leave_planes_or_join_them(table):
    by_plane, both = causes.summary(table, "alpha", "slope"), causes.summary(table)
    assert both["scenes"].tolist() == [2] * 12 + [1] * 4
    assert len(by_plane) == 2 * len(both)
    points = table.query("cause == 'points' and is_base")
    assert both["cost_db"][0] == pytest.approx(points["cost_db"].mean())
    assert math.isnan(both.query("cause == 'border'")["alone_db"].iloc[0])
    assert (causes.summary(table.assign(psnr_db=100.0))["psnr_db"] == 70).all()
