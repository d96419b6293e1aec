"""Rays meet surfaces where the defining equation x = X + d(X, Y) p says so."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.simulator.surfaces import Dome, Plane
from tests.simulator import drawing

X, Y = torch.meshgrid(*(torch.linspace(-60, 60, 41, dtype=torch.float64),) * 2, indexing="xy")
GEOMETRIES = [
    Plane(0.7),
    Plane(-0.4, (0.02, -0.03)),
    Plane(3.0, (0.0, 0.05)),
    Dome(-0.5, 2.0, 40.0),
    Dome(0.5, -1.5, 30.0, (7.0, -12.0)),
]


def gap(geometry, p, q):
    """How far from its pixel a ray through the point that it is said to meet arrives."""
    at_x, at_y = drawing.intersect(geometry, X, Y, torch.tensor(p), torch.tensor(q))
    disparity = geometry.disparity_at(at_x, at_y)
    return max(float((at_x + disparity * p - X).abs().max()), float((at_y + disparity * q - Y).abs().max()))


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize(("p", "q"), [(0.0, 0.0), (3.0, -3.0), (-3.5, 3.5), (1.2, 0.0)])
def test_the_point_met_is_seen_at_the_pixel(geometry, p, q):
    assert gap(geometry, p, q) < 1e-6


@given(
    st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(5, 100), st.floats(-0.99, 0.99), st.floats(-3.5, 3.5), st.data()
)
def test_every_legal_dome_is_met(disparity, centre, radius, share, p, data):
    # As steep as a scene of 7 x 7 views allows.
    dome = Dome(disparity, 1.0, radius, (centre * radius, 0.0))
    dome = Dome(disparity, share * 0.5 / sum(3.5 * s for s in dome.steepness()), radius, dome.centre)
    assert gap(dome, p, data.draw(st.floats(-3.5, 3.5))) < 1e-4


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_disparities_stay_in_their_range_and_below_their_steepness(geometry):
    low, high = geometry.disparity_range((121, 121))
    disparity = geometry.disparity_at(X, Y)
    assert low - 1e-9 <= float(disparity.min())
    assert float(disparity.max()) <= high + 1e-9
    across, down = (disparity.diff(dim=dim).abs().max() / 3 for dim in (1, 0))
    assert float(across) <= geometry.steepness()[0] + 1e-9
    assert float(down) <= geometry.steepness()[1] + 1e-9
