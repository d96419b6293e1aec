"""Misalignment: views move as by Fourier's shift, by as much as sigma says, each by its own draw."""

import pytest
import torch

from lfref.functional import fourier
from lfref.simulator.effects import displacement
from lfref.simulator.effects.displacement import Misalignment

from .conftest import applied


def band_limited(height, width, share):
    """A periodic picture without frequencies above `share` cycles a pixel, of spread 1."""
    spectrum = torch.fft.rfft2(torch.randn(height, width, dtype=torch.float64))
    low = (fourier.frequencies(height)[:, None].abs() <= share) & (fourier.half_frequencies(width) <= share)
    picture = torch.fft.irfft2(spectrum * low, s=(height, width))
    return picture / picture.std()


@pytest.mark.parametrize(("share", "tolerance"), [(0.1, 1e-4), (0.15, 2e-3)])
def test_a_band_limited_picture_moves_as_by_fouriers_shift(share, tolerance):
    picture, (dx, dy) = band_limited(48, 50, share), (0.37, -1.2)
    made = displacement.shift(picture.expand(1, 1, 3, 48, 50), torch.tensor([[[dx, dy]]]))[0, 0, 0]
    down = fourier.shift_phases(fourier.frequencies(48), torch.tensor(-dy, dtype=torch.float64))[:, None]
    across = fourier.shift_phases(fourier.half_frequencies(50), torch.tensor(-dx, dtype=torch.float64))
    expected = torch.fft.irfft2(torch.fft.rfft2(picture) * down * across, s=(48, 50))
    torch.testing.assert_close(made[8:-8, 8:-8], expected[8:-8, 8:-8], atol=tolerance, rtol=0)


def test_whole_shifts_move_to_the_right_and_down():
    views = torch.rand(2, 2, 3, 9, 9)
    shifts = torch.tensor([[[0, 0], [1, 0]], [[0, 1], [-2, 3]]])
    made = displacement.shift(views, shifts)
    assert torch.equal(made[0, 0], views[0, 0])
    assert torch.equal(made[0, 1, ..., 1:], views[0, 1, ..., :-1])
    assert torch.equal(made[1, 0, :, 1:], views[1, 0, :, :-1])
    assert torch.equal(made[1, 1, :, 3:, :-2], views[1, 1, :, :-3, 2:])


def test_shifts_spread_as_sigma_says():
    # On a ramp a shift is a difference of values.
    ramp = torch.arange(20, dtype=torch.float64)
    moved = ramp[10] - applied(Misalignment(0.2), ramp.expand(60, 60, 3, 1, 20))[:, :, 0, 0, 10]
    assert float(moved.std()) == pytest.approx(0.2, rel=0.05)
    assert abs(float(moved.mean())) < 0.02


def test_all_colours_of_a_view_move_together_and_each_seed_moves_differently():
    views = torch.rand(3, 3, 1, 8, 8).expand(3, 3, 3, 8, 8)
    made = applied(Misalignment(0.5), views)
    assert torch.equal(made[:, :, 0], made[:, :, 2])
    assert not torch.equal(made, applied(Misalignment(0.5), views, seed=1))
