"""Highlights and reflections of layers; what is seen of them is tested where they are painted, in `test_bitmaps`."""

import math

import pytest
import torch

from lfref.simulator import layers
from lfref.simulator.layers import Highlight
from lfref.simulator.materials import Glossy, Mirror
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Flat

POINT = torch.zeros(1, 1, 1, dtype=torch.float64)


def test_a_highlight_that_is_spread_keeps_its_light():
    lobe = Highlight(0.8, 0.4, 0.0, 2.0, 1.0, 3.0, -1.0)
    x = torch.arange(-30, 31, dtype=torch.float64)
    for way in (0.0, 5.0):
        light = lobe.on((x[None, None], x[None, :, None]), POINT + 1, POINT - 2, way)
        expected = torch.tensor([0.8, 0.4, 0.0], dtype=torch.float64) * math.tau * 4
        torch.testing.assert_close(light.sum((0, 2, 3)), expected, atol=1e-6, rtol=0)
        # Its top is at centre + drift (p, q).
        assert divmod(int(light[0, 0].argmax()), 61) == (30 - 3, 30 + 4)


@pytest.mark.parametrize(
    ("surface", "hides", "only_shifts"),
    [
        (Surface(Plane(0.0), Flat()), True, True),
        (Surface(Plane(0.0, (0.01, 0.0)), Flat()), True, False),
        (Surface(Dome(0.0, 0.1, 9.0), Flat()), True, False),
        (Surface(Plane(0.0), Flat(), Disc(9.0)), False, True),
        (Surface(Plane(0.0), Flat(), opacity=0.9), False, True),
        (Surface(Plane(0.0), Flat(), material=Mirror(1.0), opacity=0.0), True, False),
        (Surface(Plane(0.0), Flat(), material=Glossy(0.0)), True, True),
        (Surface(Plane(0.0), Flat(), material=Glossy(0.1)), True, False),
    ],
)
def test_what_a_surface_hides_and_how_it_looks_from_elsewhere(surface, hides, only_shifts):
    assert layers.hides(surface) is hides
    assert layers.only_shifts(surface) is only_shifts
