"""Chromatic aberration: closed forms on ramps, and a colour that is in focus at another slope."""

import torch

from lfref import geometry
from lfref.functional import fourier
from lfref.simulator.effects.displacement import Chromatic, disperse

from .conftest import GRID

EQUAL, NONE = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)


def test_size_1_is_the_identity():
    views = torch.rand(3, 4, 3, 9, 10)
    assert torch.equal(disperse(views, EQUAL, NONE), views)


def test_each_colours_radius_shrinks_by_its_magnification():
    y, x = geometry.angular_offsets(41)[:, None], geometry.angular_offsets(50)
    views = (x**2 + y**2).expand(2, 2, 3, 41, 50)
    sizes = (1.03, 1.0, 0.96)
    made = disperse(views, sizes, NONE)
    inner = (..., slice(6, -6), slice(6, -6))
    for channel, size in enumerate(sizes):
        torch.testing.assert_close(made[:, :, channel][inner], views[:, :, channel][inner] / size**2)


def test_each_colours_disparity_is_added_to_the_surfaces():
    disparity, more = 0.4, (0.3, 0.0, -0.25)
    p, q = geometry.angular_offsets(3)[None, :, None, None], geometry.angular_offsets(2)[:, None, None, None]
    y, x = geometry.angular_offsets(30)[:, None], geometry.angular_offsets(31)

    def slanted(d):
        return (x - d * p) + 2 * (y - d * q)

    made = disperse(slanted(disparity)[:, :, None].expand(2, 3, 3, 30, 31), EQUAL, more)
    for channel, extra in enumerate(more):
        expected = slanted(disparity + extra)
        torch.testing.assert_close(made[:, :, channel, 5:-5, 5:-5], expected[..., 5:-5, 5:-5])


def test_a_wave_moves_as_by_fouriers_shift():
    wave = torch.cos(2 * torch.pi * 3 * torch.arange(60, dtype=torch.float64) / 60)
    made = disperse(wave.expand(1, 3, 3, 5, 60), EQUAL, (0.5, 0.0, 0.0))
    phases = fourier.shift_phases(fourier.half_frequencies(60), torch.tensor([0.5, 0, -0.5], dtype=torch.float64))
    expected = torch.fft.irfft(torch.fft.rfft(wave) * phases, n=60)
    torch.testing.assert_close(made[0, :, 0, 2, 8:-8], expected[:, 8:-8], atol=2e-7, rtol=0)
    assert torch.equal(made[:, :, 1:], wave.expand(1, 3, 2, 5, 60))


def test_the_reason_names_what_is_equal():
    assert Chromatic().inert(GRID) == "all colours share magnification and focus"
    single = (1, 1)
    assert Chromatic(disparity=(0.1, 0, 0)).inert(single) == "a single view has no focus"
    assert Chromatic((1.1, 1, 1)).inert(single) is None
