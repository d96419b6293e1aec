"""The Bayer mosaic keeps, of every pixel, the colour that its pattern spells."""

import pytest
import torch

from lfref.errors import InputError
from lfref.simulator.effects.mosaic import PATTERNS, Mosaic, mosaicked

from .conftest import GRID


@pytest.mark.parametrize("pattern", list(PATTERNS))
@pytest.mark.parametrize("size", [(4, 6), (5, 3)])
def test_the_pattern_spells_what_is_kept(pattern, size):
    views = torch.rand(2, 2, 3, *size)
    raw = mosaicked(views, pattern)
    assert raw.shape == (2, 2, 1, *size)
    for y in range(size[0]):
        for x in range(size[1]):
            channel = "RGB".index(pattern[2 * (y % 2) + x % 2])
            assert torch.equal(raw[:, :, 0, y, x], views[:, :, channel, y, x])


def test_grey_stays_as_it_is():
    grey = torch.rand(1, 2, 1, 6, 6)
    assert torch.equal(mosaicked(grey.expand(1, 2, 3, 6, 6), "BGGR"), grey)


@pytest.mark.parametrize("size", [(2, 8), (8, 1)])
def test_views_too_small_to_demosaic_are_refused(size):
    with pytest.raises(InputError, match=f"at least 3x3 pixels; got {size[0]}x{size[1]}"):
        mosaicked(torch.rand(1, 1, 3, *size), "RGGB")


def test_no_pattern_is_inert():
    assert Mosaic(None).inert(GRID) == "every pixel sees three colours"
    assert Mosaic().inert(GRID) is None
