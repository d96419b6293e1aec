"""Planes over a scene's range: its ends, a width at which something changes, and slopes that the views allow."""

import pytest
import torch

from lfref.captures.inspect import AutoPlanes
from lfref.errors import InputError
from lfref.geometry import checked_slopes
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


def field(grid=(7, 7), size=(128, 192)) -> LightField:
    return LightField(torch.full((*grid, 1, *size), 0.5))


def test_planes_run_from_end_to_end_of_a_scene():
    made = simulate(sim30.SCENES["shards"], outputs=["views", "disparity"])
    planes = AutoPlanes(9).of(LightField(made.views))
    assert len(planes) == 9
    assert planes.values[0] == pytest.approx(float(made.disparity.min()), abs=0.1)
    assert planes.values[-1] == pytest.approx(float(made.disparity.max()), abs=0.1)
    torch.testing.assert_close(planes.slopes.diff(), planes.slopes.diff()[:1].expand(8))


def test_each_light_field_has_its_own():
    deep, flat = (simulate(sim30.SCENES[name], outputs=["views"]).views for name in ("deep", "dome"))
    assert AutoPlanes().of(LightField(deep)).values[0] < -2.5
    assert AutoPlanes().of(LightField(flat)).values[0] > -0.5


def test_a_single_plane_is_surrounded_by_planes_that_blur_it():
    planes = AutoPlanes(5).between((0.4, 0.4), field())
    assert planes.values[2] == pytest.approx(0.4)
    # Half a pixel at the outermost views, three steps from the centre.
    assert planes.values[4] - planes.values[2] == pytest.approx(0.5 / 3)


def test_where_nothing_is_seen_they_run_from_minus_1_to_1():
    planes = AutoPlanes(3).of(field())
    assert planes.values == (-1.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("grid", "size"), [((7, 7), (12, 12)), ((14, 14), (30, 40)), ((1, 9), (1, 40)), ((1, 1), (2, 2))]
)
def test_no_plane_moves_a_view_too_far(grid, size):
    planes = AutoPlanes(4).between((-9.0, 9.0), field(grid, size))
    checked_slopes(planes.slopes, grid, size)


@pytest.mark.parametrize("n", [0, -1, 2.5, True, "16"])
def test_a_number_of_planes_that_is_none_is_refused(n):
    with pytest.raises(InputError, match=r"planes\.n must be a whole number of at least 1"):
        AutoPlanes(n)
