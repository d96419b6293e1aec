"""Brightness from view to view: known gains are measured; clipped, dark and hidden windows are unknown."""

import dataclasses

import pytest
import torch
from torch.nn import functional as F

from lfref.captures import brightness
from lfref.captures.brightness import block_means
from lfref.lightfield import LightField

from .scenes import clean, ratios

UNLIMITED = torch.full((3,), torch.inf)


def still(views):
    """Ratios of views of a scene at disparity 0."""
    grid, size = views.shape[:2], views.shape[-2:]
    return brightness.ratios(LightField(views), torch.zeros(size), (grid[0] // 2, grid[1] // 2))


def test_gains_are_measured_as_logarithms():
    field = clean("shards")
    gains = 1 + 0.2 * torch.rand(7, 7, 3)
    gains[3, 3] = 1
    dimmer = dataclasses.replace(field, views=0.7 * field.views * gains[..., None, None])
    changed, before = ratios(dimmer), ratios(field)
    both = changed.known & before.known
    assert float(both.float().mean()) > 0.8
    # Disparities are estimated anew, so that windows lie a little elsewhere.
    assert float((changed.log - before.log - gains.log()[..., None]).abs().amax(2)[both].median()) < 0.003


@pytest.mark.parametrize(("gain", "expected"), [(0.025, 0.025), (0.015, 0.02)])
def test_ratios_count_down_to_a_fiftieth(gain, expected):
    views = torch.full((1, 3, 1, 48, 48), 0.5)
    views[0, 0] *= gain
    torch.testing.assert_close(still(views).log[0, 0], torch.full((1, 16), expected).log())


@pytest.mark.parametrize(("light", "is_known"), [(0.985, False), (0.975, True)])
def test_nearly_clipped_windows_are_unknown(light, is_known):
    views = torch.full((1, 3, 1, 48, 48), 0.5)
    views[..., :12, :12] = light
    assert bool(still(views).known[0, 0, 0]) == is_known


@pytest.mark.parametrize(("light", "is_known"), [(0.035, True), (0.025, False)])
def test_windows_with_three_hundredths_of_the_light_are_known(light, is_known):
    views = torch.full((1, 3, 1, 144, 144), 0.5)
    views[..., :12, :12] *= light
    assert bool(still(views).known[0, 0, 0]) == is_known


def test_clipped_windows_and_views_without_weight_are_unknown():
    views = 0.5 + 0.2 * torch.rand(3, 64, 96).expand(3, 3, -1, -1, -1).clone()
    views[..., :12, :12] = 1.0
    weight = torch.ones(3, 3, 1, 64, 96)
    weight[0, 2] = 0
    known = brightness.ratios(LightField(views, weight=weight), torch.zeros(64, 96), (1, 1)).known
    assert not bool(known[..., 0].any())
    assert not bool(known[0, 2].any())
    # The windows beside it may read a hair beyond their edge.
    assert bool(known[1].unflatten(1, (5, 8))[:, 2:, 2:].all())


def test_the_longer_side_has_24_windows():
    assert still(torch.full((1, 2, 1, 64, 480), 0.5)).shape == (3, 24)


def test_windows_are_placed_where_the_views_show_them():
    views = 0.5 + 0.1 * torch.rand(5, 5, 3, 64, 96)
    result = brightness.ratios(LightField(views), torch.full((64, 96), 0.5), (2, 2))
    half_diagonal = (64**2 + 96**2) ** 0.5 / 2
    y, x = result.places
    torch.testing.assert_close(y[4] - y[2], torch.full_like(y[4], 0.5 * 2 / half_diagonal))
    torch.testing.assert_close(x[:, 0] - x[:, 2], torch.full_like(x[:, 0], -0.5 * 2 / half_diagonal))
    assert float(y[2, 2, 0]) == float(torch.tensor((6 - 32) / half_diagonal))


@pytest.mark.parametrize(("factor", "size"), [(1, (5, 7)), (4, (17, 30)), (5, (5, 12))])
def test_blocks_are_averaged(factor, size):
    images = torch.rand(4, 3, *size)
    torch.testing.assert_close(block_means(images, factor, UNLIMITED), F.avg_pool2d(images, factor))


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_a_block_with_a_clipped_sample_is_unknown(dtype):
    images = torch.full((2, 3, 8, 12), 0.5, dtype=dtype)
    images[1, 2, 5, 6] = 0.9
    expected = torch.full((2, 3, 2, 3), 0.5, dtype=dtype)
    expected[1, 2, 1, 1] = torch.nan
    means = block_means(images, 4, torch.tensor([0.8, 0.8, 0.9]))
    torch.testing.assert_close(means, expected, equal_nan=True)
