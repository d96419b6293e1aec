"""Rays of a row of pixels against the surfaces' own methods, layers over one another against sorting, and atlases."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.simulator import rays
from lfref.simulator.layers import Highlight, Layer
from lfref.simulator.rays import AtlasEntry, RayRow
from lfref.simulator.scene import Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat
from tests.simulator import drawing

WIDTH = 30


def tables(geometry, box=(-np.inf, -np.inf, np.inf, np.inf), highlight=None):
    layer = Layer(Surface(geometry, Flat()), None, highlight=highlight)
    return rays.ray_layers([layer], [geometry.ray_disparity_range((60, 60), (3, 3))], [box], [(0, -1)])


def met(geometry, row, begin=0, stop=WIDTH):
    at = np.full((5, WIDTH), np.nan)
    rays.intersect(tables(geometry), 0, row, begin, stop, at)
    return at


@settings(deadline=None, max_examples=80)
@given(drawing.GEOMETRIES, st.floats(-2, 2), st.floats(-2, 2), st.floats(-30, 30))
def test_rays_meet_a_surface_where_it_says(geometry, p, q, y):
    at = torch.from_numpy(met(geometry, RayRow(p, q, -14.5, y, 0.0, 0.0)))
    x = torch.arange(WIDTH, dtype=torch.float64) - 14.5
    ray = x, *(torch.tensor(value, dtype=torch.float64) for value in (y, p, q))
    torch.testing.assert_close(at[2], geometry.ray_disparity(*ray).expand(WIDTH), atol=1e-6, rtol=0)
    at_x, at_y = drawing.intersect(geometry, *ray)
    torch.testing.assert_close(at[:2], torch.stack([at_x, at_y.expand(WIDTH)]), atol=1e-5, rtol=0)


@settings(deadline=None, max_examples=80)
@given(drawing.GEOMETRIES, st.floats(-2, 2), st.floats(-2, 2), st.floats(-20, 20), drawing.PLACE, st.floats(0, 20))
def test_what_lies_in_a_box_is_reached(geometry, p, q, y, centre, half):
    row = RayRow(p, q, -14.5, y, 0.0, 0.0)
    at, box = met(geometry, row), (centre[0] - half, centre[1] - half, centre[0] + half, centre[1] + half)
    is_within = (abs(at[0] - centre[0]) <= half - 1e-9) & (abs(at[1] - centre[1]) <= half - 1e-9)
    begin, stop = rays.visible_pixels(tables(geometry, box), 0, row, WIDTH)
    assert 0 <= begin <= stop <= WIDTH or (begin, stop) == (0, 0)
    assert not is_within[:begin].any()
    assert not is_within[stop:].any()


def test_a_highlight_keeps_its_light_however_far_it_moves_within_a_cell():
    lobe = Highlight(0.8, 0.4, 0.0, 2.0, 3.0, 1.0, 0.5)
    table, light = tables(Plane(0.5), highlight=lobe), []
    for cell in (0.0, 1.0):
        total = np.zeros(3)
        for y in range(-30, 31):
            row = RayRow(1.0, -1.0, -29.0, float(y), 2.0, cell)
            at, rgba = np.zeros((5, 60)), np.zeros((4, 60))
            rgba[3] = 0.5
            rays.intersect(table, 0, row, 0, 60, at)
            rays.add_highlight(table, 0, row, 0, 60, at, rgba)
            total += rgba[:3].sum(1)
        light.append(total)
    np.testing.assert_allclose(light[0], np.array([0.8, 0.4, 0.0]) * 0.5 * 2 * np.pi * 4, rtol=1e-4)
    np.testing.assert_allclose(light[1], light[0], rtol=1e-4)


def stacked(n_layers, seed=0):
    random = np.random.default_rng(seed)
    rgba = random.random((n_layers, 4, WIDTH)).astype(np.float32)
    rgba[:, :3] *= rgba[:, 3:]
    rgba *= random.random((n_layers, 1, WIDTH)) > 0.2
    at = random.integers(0, 4, (n_layers, 5, WIDTH)).astype(float)
    return rgba, at


def by_sorting(rgba, disparities):
    sight = np.zeros((3, WIDTH), np.float32)
    for x in range(WIDTH):
        for k in np.argsort(disparities[:, x], kind="stable"):
            sight[:, x] = rgba[k, :3, x] + (1 - rgba[k, 3, x]) * sight[:, x]
    return sight


@pytest.mark.parametrize("n_layers", [1, 2, 5])
def test_layers_are_laid_in_the_order_of_their_disparities(n_layers):
    rgba, at = stacked(n_layers)
    row, room = RayRow(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), np.empty(WIDTH, np.float32)
    ranked, shared = np.full((2, 3, WIDTH), np.nan, np.float32)
    rays.composite_by_depth(rgba, at[:, 2], np.empty(n_layers, np.int64), ranked)
    np.testing.assert_allclose(ranked, by_sorting(rgba, at[:, 2]), atol=1e-6)
    none = np.zeros((n_layers, n_layers), np.bool_)
    rays.composite_crossing(rgba, at, none, row, room, shared)
    np.testing.assert_allclose(shared, by_sorting(rgba, at[:, 2]), atol=1e-6)


def test_layers_that_cross_within_a_cell_share_it():
    """Over a cell the lead goes evenly from -0.5 to 1.5 times the step of disparity across it: 3 / 4 are ahead."""
    rgba, at = np.ones((2, 4, WIDTH), np.float32), np.zeros((2, 5, WIDTH))
    rgba[0, :3] = 0
    # The gradient of the lead, (0.06, 0.08), has the length 0.1.
    at[1, 2:] = [[0.05], [0.06], [0.08]]
    crosses = ~np.eye(2, dtype=np.bool_)
    sight, room = np.empty((3, WIDTH), np.float32), np.empty(WIDTH, np.float32)
    row = RayRow(0.0, 0.0, 0.0, 0.0, 4.025, 0.5)
    rays.composite_crossing(rgba, at, crosses, row, room, sight)
    np.testing.assert_allclose(sight, 0.75, rtol=1e-6)


def entry(shape=(6, 8), visible=(slice(None), slice(None)), top=-4, left=10):
    samples = np.zeros((*shape, 4), np.float32)
    samples[(*visible, 3)] = 0.5
    return AtlasEntry(samples, samples[..., 3], top, left)


def test_pictures_follow_each_other():
    entries = [entry(), entry((3, 4))]
    entries[1].samples[1, 2, 3] = 7
    atlas = rays.atlas(entries, 2)
    assert atlas.frames.tolist() == [[0, 6, 8, -4, 10], [192, 3, 4, -4, 10]]
    assert atlas.samples[192 + 4 * (1 * 4 + 2) + 3] == 7
    assert rays.atlas([], 2).frames.shape == (0, 5)


@pytest.mark.parametrize(
    ("visible", "expected"),
    [
        ((slice(2, 4), slice(3, 5)), (5.5, -2.0, 8.0, 0.5)),
        ((slice(0, 4), slice(3, 8)), (5.5, -math.inf, math.inf, 0.5)),
        ((slice(0), slice(0)), (math.inf, math.inf, -math.inf, -math.inf)),
    ],
)
def test_a_box_holds_what_is_seen_and_has_no_end_where_that_touches_the_rim(visible, expected):
    assert rays.visible_box(entry(visible=visible), 1, 2) == expected
