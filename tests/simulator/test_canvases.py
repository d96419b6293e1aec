"""Canvases cover what is asked for, on the same grid whatever they cover."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.simulator import canvases

SIDE = st.floats(-500, 500)


@given(SIDE, SIDE, st.floats(0, 300), st.floats(0, 300))
def test_a_canvas_covers_its_box_in_half_pixels(left, top, width, height):
    canvas = canvases.covering((left, top, left + width, top + height), (8, 8))
    for axis, first, length in ((canvas.x, left, width), (canvas.y, top, height)):
        assert float(axis[0]) <= first
        assert float(axis[-1]) >= first + length
        assert float(axis[-1] - axis[0]) <= length + 1.5
        assert bool((axis * canvases.OVERSAMPLING == (axis * canvases.OVERSAMPLING).round()).all())
    assert canvas.width % 2 == 0
    assert (len(canvas.y), len(canvas.x)) == (canvas.height, canvas.width)


def test_boxes_intersect_in_what_they_share_or_in_a_point():
    assert canvases.intersection((0, 0, 4, 4), (1, -2, 9, 3)) == (1, 0, 4, 3)
    left, top, right, bottom = canvases.intersection((0, 0, 4, 4), (5, 6, 9, 9))
    assert (left, top) == (right, bottom) == (5, 6)


@pytest.mark.parametrize(("length", "fast"), [(1, 2), (7, 8), (13, 16), (205, 216), (255.5, 256), (300, 300)])
def test_lengths_are_rounded_up_to_quick_even_ones(length, fast):
    assert canvases.fast_length(length) == fast
    assert torch.fft.rfft(torch.zeros(fast)).numel() == fast // 2 + 1
