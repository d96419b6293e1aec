"""Which surfaces cross, and how far rays go, against rays drawn at random."""

import pytest
import torch
from hypothesis import given, settings

from lfref.simulator import layers
from lfref.simulator.scene import Camera
from lfref.simulator.surfaces import Dome, Plane
from tests.simulator import drawing

CAMERA = Camera((5, 7), (40, 48))


def random_rays(slope, n=2000):
    """(x, y, p, q) of pixels and aperture points, the corners among them."""
    shares = torch.rand(4, n, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 2 - 1
    shares[:, :16] = shares[:, :16].sign()
    half = torch.tensor([23.5, 19.5, 3.5, 2.5], dtype=torch.float64)
    x, y, p, q = shares * half[:, None]
    return x + slope * p, y + slope * q, p, q


@settings(deadline=None, max_examples=60)
@given(drawing.GEOMETRIES)
def test_no_ray_goes_farther(geometry):
    x, y, p, q = random_rays(2.0)
    met = geometry.met_at(x, y, p, q)
    low, high = layers.span(CAMERA, geometry, 2.0)
    assert low - 1e-9 <= float(met.min()) <= float(met.max()) <= high + 1e-9
    right, bottom = layers.ends(CAMERA, geometry, 2.0)
    assert float((x - met * p).abs().max()) <= right - layers.SLACK + 1e-9
    assert float((y - met * q).abs().max()) <= bottom - layers.SLACK + 1e-9


@settings(deadline=None, max_examples=100)
@given(drawing.GEOMETRIES, drawing.GEOMETRIES)
def test_surfaces_that_do_not_cross_keep_their_order_along_every_ray(one, other):
    rays = random_rays(2.0)
    leads = other.met_at(*rays) - one.met_at(*rays)
    if not layers.crossing([one, other], CAMERA, 2.0):
        ahead = layers.is_before(other, one, CAMERA, 2.0)
        assert ahead or layers.is_before(one, other, CAMERA, 2.0)
        assert bool((leads >= -1e-7).all() if ahead else (leads <= 1e-7).all())


@pytest.mark.parametrize(
    ("one", "other", "crosses"),
    [
        (Plane(0.0), Plane(0.5), False),
        (Plane(0.0), Plane(0.0), False),
        (Plane(0.0), Plane(1.0, (0.01, 0.0)), False),
        (Plane(0.0), Plane(0.1, (0.01, 0.0)), True),
        (Plane(0.0, (0.02, 0.01)), Plane(0.1, (0.02, 0.01)), False),
        (Dome(0.0, 0.5, 30.0), Plane(0.5), False),
        (Dome(0.0, 0.5, 30.0), Plane(0.0), False),
        (Dome(0.0, 0.5, 30.0), Plane(0.3), True),
        (Dome(0.0, -0.5, 30.0), Plane(-0.3), True),
    ],
)
def test_only_surfaces_that_change_places_cross(one, other, crosses):
    assert bool(layers.crossing([one, other], CAMERA, 0.0)) is crosses
    assert bool(layers.crossing([other, one], CAMERA, 0.0)) is crosses


def test_pairs_are_named_by_their_places():
    surfaces = [Plane(-1.0), Plane(0.0, (0.02, 0.0)), Plane(0.9), Plane(0.0, (-0.02, 0.0))]
    assert layers.crossing(surfaces, CAMERA, 0.0) == [(1, 3)]
