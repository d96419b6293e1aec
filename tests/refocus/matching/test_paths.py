"""Cheapest ways: those of all ways tried one by one, and maps that are smooth where nothing is to be told."""

import itertools

import numpy as np
import pytest
import torch

from lfref.refocus.disparity import matching

CHANGE = 0.3


def price(before, after, jump):
    return 0.0 if before == after else CHANGE if abs(before - after) == 1 else jump


@pytest.mark.parametrize("direction", [step for part in matching.DIRECTIONS for step in part])
def test_a_way_costs_what_the_cheapest_of_all_ways_costs(direction):
    down, right = direction
    random = np.random.default_rng(5)
    costs, jumps = random.random((4, 4, 4)).astype(np.float32), (1 + random.random((4, 4))).astype(np.float32)
    total = np.zeros_like(costs)
    matching.add_paths(costs, jumps, CHANGE, down, right, total)
    # The line that ends at one of the pixels which a whole diagonal, row or column leads to.
    line = [(3 * (down < 0) + down * i, 3 * (right < 0) + right * i) for i in range(4)]
    cheapest = np.full(4, np.inf)
    for labels in itertools.product(range(4), repeat=4):
        here = sum(float(costs[y, x, label]) for (y, x), label in zip(line, labels, strict=True))
        here += sum(price(a, b, jumps[line[i + 1]]) for i, (a, b) in enumerate(itertools.pairwise(labels)))
        cheapest[labels[-1]] = min(cheapest[labels[-1]], here)
    found = total[line[-1]]
    np.testing.assert_allclose(found - found.min(), cheapest - cheapest.min(), atol=1e-5)


def test_pixels_that_cannot_tell_take_the_label_around_them():
    costs = torch.full((5, 20, 24), 0.5)
    costs[2] = 0.1
    costs[:, 8:12, 9:15] = 0.3  # nothing is to be told here
    assert bool((matching.aggregate(costs, torch.full((20, 24), 0.4)).argmin(0) == 2).all())


def test_single_wrong_pixels_are_outvoted_and_whole_surfaces_are_not():
    costs = torch.full((7, 24, 24), 0.6)
    costs[1, :, :12], costs[5, :, 12:] = 0.1, 0.1
    costs[4, 6, 5] = 0.0
    picture = torch.cat([torch.full((24, 12), 0.2), torch.full((24, 12), 0.8)], 1)
    best = matching.aggregate(costs, picture).argmin(0)
    assert bool((best[:, :12] == 1).all())
    assert bool((best[:, 12:] == 5).all())


@pytest.mark.parametrize("size", [(1, 1), (1, 6), (5, 1)])
def test_pictures_of_a_row_or_a_pixel_are_no_error(size):
    costs = torch.rand(3, *size)
    assert matching.aggregate(costs, torch.rand(size)).shape == (3, *size)
