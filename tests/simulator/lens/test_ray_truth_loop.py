"""What a cell sees of a layer whose rays are followed: the copy that suits each pixel, and light beside it."""

import numpy as np
import pytest

from lfref.simulator import rays, truth_loops
from lfref.simulator.layers import Highlight, Layer, Reflection
from lfref.simulator.rays import Page, Row
from lfref.simulator.scene import Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat
from lfref.simulator.truth_loops import Levels

WIDTH = 20
EVERYWHERE = (-np.inf, -np.inf, np.inf, np.inf)


def constant(value, opacity=1.0):
    samples = np.full((4, 6, 4), value, np.float32)
    samples[..., 3] = opacity
    return Page(samples, samples[..., 3], -3, -2)


def seen(layer, pictures, places, box=EVERYWHERE, slope=1.0, mirrored=-1):
    sights = rays.sights([layer], [(-9.0, 9.0)], [box], [(0, mirrored)])
    at, rgba = np.zeros((5, WIDTH)), np.full((4, WIDTH), np.nan, np.float32)
    levels = Levels(np.array([places], float), np.array([1.0]))
    row = Row(0.0, 0.0, -9.5, 0.0, slope, 0.5)
    return truth_loops.see(sights, levels, rays.atlas(pictures), 0, row, at, rgba), rgba


def test_pixels_read_between_the_copies_that_suit_how_far_they_are_out_of_focus():
    layer = Layer(Surface(Plane(0.0, (0.1, 0.0)), Flat()), None)
    (begin, stop), rgba = seen(layer, [constant(value) for value in (0.0, 1.0, 3.0)], [0, 1, 2])
    e = np.abs(1 - 0.1 * (np.arange(WIDTH) - 9.5))
    assert (begin, stop) == (0, WIDTH)
    np.testing.assert_allclose(rgba[0], np.interp(e, [0, 1, 2], [0, 1, 3]), atol=1e-6)
    np.testing.assert_allclose(rgba[3], 1, atol=1e-6)


def test_only_what_may_be_seen_is_filled():
    layer = Layer(Surface(Plane(0.0), Flat()), None)
    (begin, stop), rgba = seen(layer, [constant(0.5)], [0, 0], (-2.0, -1.0, 3.0, 1.0))
    assert np.isfinite(rgba[:, begin:stop]).all()
    assert np.isnan(rgba[:, :begin]).all()
    assert begin <= 7.5 <= 12.5 <= stop < WIDTH
    assert seen(layer, [constant(0.5)], [0, 0], (-2.0, 5.0, 3.0, 9.0))[0] == (0, 0)


def test_highlights_and_reflections_are_added_in_proportion_to_opacity():
    highlight, reflection = Highlight(1.0, 0.5, 0.0, 2.0, 0.0, 0.5, 0.0), Reflection(None, 0.5, 0.0)
    layer = Layer(Surface(Plane(1.0), Flat()), None, highlight=highlight, reflection=reflection)
    _, rgba = seen(layer, [constant(0.25, 0.5), constant(0.8)], [0, 0], mirrored=1)
    assert rgba[:3, 10].tolist() == pytest.approx([0.25 + 0.5 + 0.2, 0.25 + 0.25 + 0.2, 0.25 + 0.2])
