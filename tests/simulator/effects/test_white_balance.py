"""White balance is one factor a channel, exactly, and undoes the colour of the light."""

import torch

from lfref.simulator.effects.response import WhiteBalance

from .conftest import GRID, applied


def test_every_channel_has_its_gain():
    views = torch.rand(2, 3, 3, 4, 5)
    made = applied(WhiteBalance((2.0, 1.0, 0.7)), views)
    for channel, gain in enumerate((2.0, 1.0, 0.7)):
        assert torch.equal(made[:, :, channel], views[:, :, channel] * gain)


def test_gains_undo_the_colour_of_the_light():
    white = torch.rand(1, 1, 1, 4, 4).expand(1, 1, 3, 4, 4)
    lit = white * torch.tensor([0.5, 1.0, 0.8])[:, None, None]
    torch.testing.assert_close(applied(WhiteBalance((2.0, 1.0, 1.25)), lit), white)


def test_only_three_gains_of_1_are_inert():
    assert WhiteBalance().inert(GRID) == "all gains are 1"
    assert WhiteBalance((1, 1, 1.1)).inert(GRID) is None
