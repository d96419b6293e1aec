"""Effects of optics: aberration and misalignment move pictures, cos^4 and rim shade them, and crosstalk mixes views."""

import math

import pytest
import torch

from lfref import geometry
from lfref.functional import fourier
from lfref.simulator.effects import optics
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, clipped_pupil, falloff
from tests.simulator.drawing import applied


def test_each_colours_radius_shrinks_by_its_magnification():
    y, x = geometry.angular_offsets(41)[:, None], geometry.angular_offsets(50)
    views = (x**2 + y**2).expand(2, 2, 3, 41, 50)
    sizes = (1.03, 1.0, 0.96)
    result = applied(Chromatic(sizes), views)
    inner = (..., slice(6, -6), slice(6, -6))
    for channel, size in enumerate(sizes):
        torch.testing.assert_close(result[:, :, channel][inner], views[:, :, channel][inner] / size**2)


def test_each_colours_disparity_is_added_to_the_surfaces():
    disparity, more = 0.4, (0.3, 0.0, -0.25)
    p, q = geometry.angular_offsets(3)[None, :, None, None], geometry.angular_offsets(2)[:, None, None, None]
    y, x = geometry.angular_offsets(30)[:, None], geometry.angular_offsets(31)

    def slanted(d):
        return (x - d * p) + 2 * (y - d * q)

    result = applied(Chromatic(disparity=more), slanted(disparity)[:, :, None].expand(2, 3, 3, 30, 31))
    for channel, extra in enumerate(more):
        expected = slanted(disparity + extra)
        torch.testing.assert_close(result[:, :, channel, 5:-5, 5:-5], expected[..., 5:-5, 5:-5])


@pytest.mark.parametrize(("share", "tolerance"), [(0.1, 1e-4), (0.15, 2e-3)])
def test_a_band_limited_picture_moves_as_by_fouriers_shift(share, tolerance):
    spectrum = torch.fft.rfft2(torch.randn(48, 50, dtype=torch.float64))
    low = (fourier.frequencies(48)[:, None].abs() <= share) & (fourier.half_frequencies(50) <= share)
    picture, (dx, dy) = torch.fft.irfft2(spectrum * low, s=(48, 50)), (0.37, -1.2)
    picture = picture / picture.std()
    result = optics.shift(picture.expand(1, 1, 3, 48, 50), torch.tensor([[[dx, dy]]]))[0, 0, 0]
    down, across = (
        torch.complex(*fourier.shift_phases(frequencies, torch.tensor(-distance, dtype=torch.float64)))
        for frequencies, distance in ((fourier.frequencies(48), dy), (fourier.half_frequencies(50), dx))
    )
    expected = torch.fft.irfft2(torch.fft.rfft2(picture) * down[:, None] * across, s=(48, 50))
    torch.testing.assert_close(result[8:-8, 8:-8], expected[8:-8, 8:-8], atol=tolerance, rtol=0)


def test_shifts_spread_as_sigma_says_and_colours_move_together():
    # On a ramp a shift is a difference of values.
    ramp = torch.arange(20, dtype=torch.float64)
    result = applied(Misalignment(0.2), ramp.expand(60, 60, 3, 1, 20))
    moved = ramp[10] - result[:, :, 0, 0, 10]
    assert float(moved.std()) == pytest.approx(0.2, rel=0.05)
    assert abs(float(moved.mean())) < 0.02
    assert torch.equal(result[:, :, 0], result[:, :, 2])


@pytest.mark.parametrize("field", [0.2, 1.0])
def test_light_falls_off_with_the_fourth_power_of_the_cosine(field):
    gain = falloff(torch.ones(1, 1, 3, 6, 8, dtype=torch.float64), field)
    for row, column in ((0, 0), (2, 5), (5, 7)):
        tangent = field * math.hypot(row - 2.5, column - 3.5) / 5
        assert float(gain[row, column]) == pytest.approx(math.cos(math.atan(tangent)) ** 4)


@pytest.mark.parametrize("displacement", [0.3, 0.8, 1.4])
def test_what_gets_through_is_the_overlap_of_rim_and_grid(displacement):
    n_views, shape = 40, (3, 3, 3)
    gain = clipped_pupil(torch.ones(n_views, n_views, *shape, dtype=torch.float64), displacement)
    radius = n_views / math.sqrt(2)
    points = (torch.arange(8 * n_views, dtype=torch.float64) + 0.5) / 8 - n_views / 2
    for row, column in ((0, 0), (1, 0), (2, 2)):
        y, x = (displacement * radius * place / (1.5 * math.sqrt(2)) for place in (row - 1, column - 1))
        inside = (points[:, None] - y) ** 2 + (points - x) ** 2 <= radius**2
        assert float(gain[:, :, 0, row, column].mean()) == pytest.approx(float(inside.double().mean()), abs=2e-3)


def test_a_single_lit_view_shows_the_kernel_of_crosstalk():
    views = torch.zeros(5, 5, 1, 1, 1, dtype=torch.float64)
    views[2, 2] = 1
    side = torch.tensor([0, 0.1, 0.8, 0.1, 0], dtype=torch.float64)
    torch.testing.assert_close(applied(Crosstalk(0.1), views)[..., 0, 0, 0], side[:, None] * side)


@pytest.mark.parametrize("grid", [(5, 5), (1, 4), (2, 3)])
def test_crosstalk_keeps_energy_and_what_all_views_share(grid):
    views = torch.rand(*grid, 3, 4, 5, dtype=torch.float64)
    torch.testing.assert_close(applied(Crosstalk(0.2), views).sum((0, 1)), views.sum((0, 1)))
    same = views[:1, :1].expand(*grid, 3, 4, 5)
    torch.testing.assert_close(applied(Crosstalk(0.3), same), same)
