"""Layers: highlights, extents against random rays, which surfaces cross, and which hide others."""

import torch
from hypothesis import given, settings

from lfref.simulator import layers
from lfref.simulator.scene import Camera
from tests.simulator import drawing, eager

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
    met = eager.ray_disparity(geometry, x, y, p, q)
    low, high = layers.disparity_span(CAMERA, geometry, 2.0)
    assert low - 1e-9 <= float(met.min()) <= float(met.max()) <= high + 1e-9
    right, bottom = layers.ray_extent(CAMERA, geometry, 2.0)
    assert float((x - met * p).abs().max()) <= right - 3 + 1e-9
    assert float((y - met * q).abs().max()) <= bottom - 3 + 1e-9


@settings(deadline=None, max_examples=100)
@given(drawing.GEOMETRIES, drawing.GEOMETRIES)
def test_surfaces_that_do_not_cross_keep_their_order_along_every_ray(one, other):
    rays = random_rays(2.0)
    leads = eager.ray_disparity(other, *rays) - eager.ray_disparity(one, *rays)
    if not layers.crossing_pairs([one, other], CAMERA, 2.0):
        ahead = layers.is_before(other, one, CAMERA, 2.0)
        assert ahead or layers.is_before(one, other, CAMERA, 2.0)
        assert bool((leads >= -1e-7).all() if ahead else (leads <= 1e-7).all())
