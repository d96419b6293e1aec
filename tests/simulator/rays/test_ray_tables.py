"""Tables of layers: where pictures lie one after the other, and where something is to be seen."""

import math

import numpy as np
import pytest

from lfref.simulator import rays
from lfref.simulator.rays import Page


def picture(shape=(6, 8), seen=(slice(None), slice(None)), top=-4, left=10):
    samples = np.zeros((*shape, 4), np.float32)
    samples[(*seen, 3)] = 0.5
    return Page(samples, samples[..., 3], top, left)


def test_pictures_follow_each_other():
    pictures = [picture(), picture((3, 4))]
    pictures[1].samples[1, 2, 3] = 7
    atlas = rays.atlas(pictures)
    assert atlas.frames.tolist() == [[0, 6, 8, -4, 10], [192, 3, 4, -4, 10]]
    assert atlas.samples[192 + 4 * (1 * 4 + 2) + 3] == 7
    assert rays.atlas([]).frames.shape == (0, 5)


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        ((slice(2, 4), slice(3, 5)), (5.5, -2.0, 8.0, 0.5)),
        ((slice(0, 4), slice(3, 8)), (5.5, -math.inf, math.inf, 0.5)),
        ((slice(0), slice(0)), (math.inf, math.inf, -math.inf, -math.inf)),
    ],
)
def test_a_box_holds_what_is_seen_and_has_no_end_where_that_touches_the_rim(seen, expected):
    assert rays.box(picture(seen=seen), margin=1.0) == expected
