"""Costs of the simulator: times, shares, rates, distances from the truth."""

from dataclasses import replace

import pytest
import torch

from lfref.bench import simulation_cost
from lfref.geometry import planes_at_alphas
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import painting
from lfref.simulator import views as central
from lfref.simulator.effects.response import Exposure
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat, Noise

CAMERA = Camera((3, 3), (24, 30))
CPU = torch.device("cpu")
PLANES = planes_at_alphas((0.5, 1.0))
WALL = Surface(Plane(0.0), Noise())
SCENES = {
    "wall": Scene(CAMERA, (WALL,), name="wall"),
    "card": Scene(CAMERA, (WALL, Surface(Plane(0.4), Flat((0.9, 0.1, 0.1)), Disc(6))), name="card"),
}


def test_costs_are_medians_of_planned_and_forced_runs():
    rows = simulation_cost.costs(SCENES, PLANES.slopes, CPU, range(3))
    assert [(row["scene"], row["output"]) for row in rows] == [
        ("wall", "views"), ("wall", "truth"), ("card", "views"), ("card", "truth"),
    ]  # fmt: skip
    for row in rows:
        assert row["planned_s"] > 0
        assert row["forced_over_planned"] == pytest.approx(row["forced_s"] / row["planned_s"])


def test_forced_simulations_are_timed_as_forced(monkeypatch):
    calls = []
    monkeypatch.setattr(simulation_cost, "simulate", lambda scene, **options: calls.append(options))
    simulation_cost.costs({"wall": SCENES["wall"]}, PLANES.slopes, CPU, range(1), warmup=0)
    assert [(call["outputs"], call["force"]) for call in calls] == [
        (("views",), False), (("views",), True), (("truth",), False), (("truth",), True),
    ]  # fmt: skip


def test_shares_of_passes_add_up():
    rows = simulation_cost.passes(SCENES, PLANES.slopes, CPU)
    for name in SCENES:
        of_scene = [row for row in rows if row["scene"] == name]
        assert {"view", "photograph"} <= {row["pass"] for row in of_scene}
        assert sum(row["share"] for row in of_scene) == pytest.approx(1)


@pytest.mark.parametrize("n_workers", [0, 2])
def test_rates_count_scenes_by_output(n_workers):
    rows = simulation_cost.rates(RandomScenes(CAMERA), 3, PLANES.slopes, CPU, n_workers)
    assert [row["output"] for row in rows] == ["views", "views and truth"]
    assert all(row["n_scenes"] == 3 and row["n_workers"] == n_workers and row["per_second"] > 0 for row in rows)


def test_patches_are_random_scenes_with_the_outputs_of_the_table(monkeypatch):
    calls = []
    monkeypatch.setattr(simulation_cost, "simulate", lambda scene, outputs, **_: calls.append((scene.name, outputs)))
    patches = simulation_cost.RandomPatches(RandomScenes(CAMERA), 2, ("views", "truth"), PLANES.slopes, CPU)
    assert [patches[index] for index in range(len(patches))] == [0, 1]
    assert calls == [(f"simulated_s0_e0_00{index}", ("views", "truth")) for index in range(2)]


def test_a_wall_in_focus_is_refocused_right_and_a_wrong_method_is_far_away():
    methods = [
        OperatorRefocuser("sum", shift_and_sum),
        OperatorRefocuser("dark", lambda views, slopes: shift_and_sum(views, slopes) * 0.5),
    ]
    dim = replace(SCENES["wall"], sensor=Sensor(exposure=Exposure(0.1)))  # the sensor is left out
    rows = simulation_cost.distances([("wall", dim)], methods, PLANES, CPU)
    summary = {(row["method"], row["alpha"]): row["psnr_db"] for row in rows}
    assert summary["sum", 1.0] > 50
    assert summary["sum", 0.5] < summary["sum", 1.0]
    assert summary["dark", 1.0] < 25


@pytest.mark.parametrize("alphas", [(1.0, 2.0), (None, None)])
def test_planes_have_the_mean_and_the_worst_scene(alphas):
    rows = [
        {"scene": scene, "method": "sum", "alpha": alphas[plane], "slope": plane / 2, "psnr_db": value}
        for scene, plane, value in (("a", 0, 30.0), ("b", 0, 90.0), ("a", 1, 50.0), ("b", 1, 20.0))
    ]
    summary = simulation_cost.by_plane(rows)
    assert summary.columns.tolist() == ["method", "alpha", "slope", "mean_db", "median_db", "worst_db", "worst_scene"]
    assert summary["alpha"].isna().all() or tuple(summary["alpha"]) == alphas
    assert summary.drop(columns="alpha").to_numpy().tolist() == [
        ["sum", 0.0, 50.0, 60.0, 30.0, "a"],
        ["sum", 0.5, 35.0, 35.0, 20.0, "b"],
    ]


@pytest.mark.parametrize("aperture", ["square", "disc"])
def test_as_many_cells_as_needed_agree_with_many_points(aperture):
    card = replace(SCENES["card"], camera=replace(CAMERA, aperture=aperture))
    (good,) = simulation_cost.aperture_errors([("card", card)], PLANES, 32, CPU)
    assert good["psnr_db"] > 45
    assert good["worst_plane"] in PLANES.labels


def test_few_points_are_not_the_whole_aperture_and_one_is_its_middle():
    layers = painting.paint(SCENES["card"], reach=1.0)
    one, few, many = (simulation_cost.through_points(layers, CAMERA, -1.0, n_points) for n_points in (1, 2, 32))
    assert torch.equal(one, central.all_in_focus(layers, CAMERA))
    assert float((few - many).abs().max()) > 0.05
