"""Rendering against a slow reference, and the sign of the disparity against shift-and-sum."""

import pytest
import torch
from torch import Generator

from lfref.refocus.shift_and_sum import shift_and_sum
from lfref.simulate import render, scenes, textures
from lfref.simulate.scenes import Layer, Scene


def layer(seed, disparity, height=26, width=29, share=None):
    generator = Generator().manual_seed(seed)
    opacity = torch.ones(1, height, width) if share is None else textures.blobs(generator, height, width, share)
    return Layer(disparity, textures.colours(generator, height, width), opacity)


def slow_views(scene, grid):
    """Every pixel on its own: the ray of (v, u, y, x) meets a layer at x - d (u - u0), y - d (v - v0)."""
    height, width = scene.layers[0].colour.shape[-2:]
    rows, columns = height - 2 * scene.margin, width - 2 * scene.margin
    views = torch.zeros(*grid, 3, rows, columns)
    for v, u, y, x in torch.cartesian_prod(*map(torch.arange, (*grid, rows, columns))).tolist():
        colour = torch.zeros(3)
        for surface in scene.layers:
            canvas_x = x + scene.margin - round(surface.disparity * (u - (grid[1] - 1) / 2))
            canvas_y = y + scene.margin - round(surface.disparity * (v - (grid[0] - 1) / 2))
            opacity = surface.opacity[0, canvas_y, canvas_x]
            colour = surface.colour[:, canvas_y, canvas_x] * opacity + colour * (1 - opacity)
        views[v, u, :, y, x] = colour
    return views


def test_whole_disparities_equal_the_slow_reference():
    scene = Scene((layer(0, -2.0), layer(1, 0.0, share=0.3), layer(2, 1.0, share=0.3), layer(3, 3.0, share=0.2)), 7)
    torch.testing.assert_close(render.views(scene, (3, 5)), slow_views(scene, (3, 5)), atol=2e-6, rtol=0)


def test_a_scene_without_margin_is_rendered_whole():
    surface = layer(0, 0.0)
    torch.testing.assert_close(render.views(Scene((surface,), 0), (1, 2))[0, 1], surface.colour, atol=1e-6, rtol=0)


@pytest.mark.parametrize("disparity", [-1.0, -0.4, 0.7, 1.3])
def test_a_layer_of_disparity_d_is_sharp_at_slope_d_and_at_no_other(disparity):
    # Band-limited and far from black and white, so that neither clamp nor aliasing is left at d.
    noise = textures.power_noise(Generator().manual_seed(0), (3, 80, 84), 1.0)
    surface = Layer(disparity, 0.5 + 0.1 * noise, torch.ones(1, 80, 84))
    margin = 7
    views = render.views(Scene((surface,), margin), (5, 5))
    slopes = [disparity, -disparity, 0.0, disparity + 0.5, disparity - 0.5]
    truth = surface.colour[:, margin:-margin, margin:-margin]
    inner = (..., slice(12, -12), slice(12, -12))
    errors = (shift_and_sum(views, slopes, "exact") - truth)[inner].square().mean((-3, -2, -1))
    assert errors[0] < 0.001 * errors[1:].min()


def test_horizontal_and_vertical_disparity_go_with_their_own_axis():
    colour = torch.zeros(3, 21, 21)
    colour[:, 10, 10] = 1
    views = render.views(Scene((Layer(2.0, colour, torch.ones(1, 21, 21)),), 0), (3, 3))
    for v in range(3):
        for u in range(3):
            assert divmod(int(views[v, u, 0].argmax()), 21) == (10 + 2 * (v - 1), 10 + 2 * (u - 1))


def test_the_nearer_layer_hides_the_farther():
    far = Layer(-1.0, torch.full((3, 20, 20), 0.25), torch.ones(1, 20, 20))
    opacity = torch.zeros(1, 20, 20)
    opacity[..., 8:12, 8:12] = 1
    near = Layer(1.0, torch.full((3, 20, 20), 0.75), opacity)
    views = render.views(Scene((far, near), 2), (3, 3))
    expected = torch.full((3, 3, 3, 16, 16), 0.25)
    for v in range(3):
        for u in range(3):
            expected[v, u, :, 6 + v - 1 : 10 + v - 1, 6 + u - 1 : 10 + u - 1] = 0.75
    torch.testing.assert_close(views, expected, atol=1e-6, rtol=0)


def test_half_transparent_layers_mix():
    def flat(disparity, level, opacity):
        return Layer(disparity, torch.full((3, 8, 8), level), torch.full((1, 8, 8), opacity))

    views = render.views(Scene((flat(0.0, 0.2, 1.0), flat(0.5, 1.0, 0.5)), 1), (2, 2))
    torch.testing.assert_close(views, torch.full((2, 2, 3, 6, 6), 0.6), atol=1e-6, rtol=0)


@pytest.mark.parametrize("seed", range(3))
def test_random_scenes_are_radiance_and_repeat(seed):
    def draw():
        scene = scenes.random_scene(Generator().manual_seed(seed), (24, 31), reach=1)
        return render.views(scene, (3, 2))

    views = draw()
    assert views.shape == (3, 2, 3, 24, 31)
    assert views.dtype == torch.float32
    assert views.is_contiguous()
    assert float(views.min()) >= 0
    assert float(views.max()) <= 1
    assert torch.equal(views, draw())


def test_no_view_sees_the_other_end_of_the_canvas():
    """A canvas whose outermost pixel is bright must not shine into any view."""
    generator = Generator().manual_seed(0)
    scene = scenes.random_scene(generator, (16, 16), (1, 1), (-1.0, 1.0), reach=3)
    edge = torch.zeros_like(scene.layers[0].colour)
    edge[..., 0, :] = edge[..., :, 0] = 1
    # At the outermost view and largest disparity the nearest edge pixel stays two pixels outside.
    shifted = Scene((Layer(1.0, edge, scene.layers[0].opacity),), scene.margin)
    assert render.views(shifted, (7, 7)).max() < 1e-5
