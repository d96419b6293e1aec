"""Scenes are ordered from far to near, stay in their ranges, and are drawn from their generator alone."""

import pytest
import torch
from torch import Generator

from lfref.errors import InputError
from lfref.simulate import scenes
from lfref.simulate.scenes import Layer, Scene


def draw(seed=0, **options):
    return scenes.random_scene(Generator().manual_seed(seed), (20, 24), **options)


def layer(disparity):
    return Layer(disparity, torch.rand(3, 4, 4), torch.ones(1, 4, 4))


def test_layers_out_of_order_or_absent_are_refused():
    assert len(Scene((layer(-1.0), layer(0.0), layer(0.0)), 0).layers) == 3
    for layers in [(), (layer(1.0), layer(0.0))]:
        with pytest.raises(InputError, match="layers ordered from small to large disparity"):
            Scene(layers, 0)


@pytest.mark.parametrize("seed", range(6))
def test_draws_stay_in_their_ranges(seed):
    scene = draw(seed, n_layers=(2, 4), disparities=(-0.5, 2.0))
    disparities = [layer.disparity for layer in scene.layers]
    assert 2 <= len(disparities) <= 4
    assert disparities == sorted(disparities)
    assert min(disparities) >= -0.5
    assert max(disparities) <= 2.0


def test_every_number_of_layers_is_drawn():
    counts = {len(draw(seed, n_layers=(1, 3)).layers) for seed in range(24)}
    assert counts == {1, 2, 3}


def test_the_background_is_full_and_islands_stand_in_front_of_it():
    scene = draw(n_layers=(3, 3))
    assert bool((scene.layers[0].opacity == 1).all())
    for island in scene.layers[1:]:
        assert 0.05 < float(island.opacity.mean()) < 0.4


@pytest.mark.parametrize(
    ("disparities", "reach", "margin"), [((-1, 1), 3, 5), ((-2.5, 1), 3, 10), ((0, 0.1), 8, 3), ((0, 0), 3, 2)]
)
def test_the_canvas_reaches_beyond_what_the_outermost_view_sees(disparities, reach, margin):
    scene = draw(disparities=disparities, reach=reach)
    assert scene.margin == margin
    for surface in scene.layers:
        assert surface.colour.shape == (3, 20 + 2 * margin, 24 + 2 * margin)
        assert surface.opacity.shape == (1, 20 + 2 * margin, 24 + 2 * margin)


def test_the_generator_fixes_the_scene():
    first, second, other = draw(3), draw(3), draw(4)
    assert [x.disparity for x in first.layers] == [x.disparity for x in second.layers]
    for one, two in zip(first.layers, second.layers, strict=True):
        assert torch.equal(one.colour, two.colour)
        assert torch.equal(one.opacity, two.opacity)
    assert [x.disparity for x in first.layers] != [x.disparity for x in other.layers]


@pytest.mark.parametrize(
    "options",
    [{"n_layers": (0, 2)}, {"n_layers": (3, 2)}, {"disparities": (1.0, -1.0)}, {"disparities": (0, torch.nan)}],
)
def test_empty_ranges_are_refused(options):
    with pytest.raises(InputError, match="ranges must go from small to large"):
        draw(**options)
