"""The noise line: its filter, its flattest blocks, and the line below which no level of light lies far."""

import pytest
import torch

from lfref.functional import noise_line
from lfref.lightfield import LightField


def noisy(light, shot, read, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return light + (shot * light + read).sqrt() * torch.randn(light.shape, generator=generator)


def test_variance_of_blocks_is_that_of_white_noise():
    pictures = noisy(torch.full((4, 130, 130), 0.5), 0.0, 1e-4)
    light, variance = noise_line.blocks(pictures)
    assert len(light) == 4 * 16**2
    assert float(variance.mean()) == pytest.approx(1e-4, rel=0.02)
    assert float(light.mean()) == pytest.approx(0.5, abs=1e-3)


def test_what_is_smooth_has_no_variance():
    y, x = torch.arange(40.0)[:, None], torch.arange(40.0)
    _, variance = noise_line.blocks((0.01 * x * y + 0.02 * x + 0.001 * y**2)[None])
    assert float(variance.max()) < 1e-9


def test_the_flattest_tenth_of_pure_noise_is_scaled_to_its_variance():
    light, variance = noise_line.blocks(noisy(torch.full((40, 82, 82), 0.5), 0.0, 1e-4))
    _, flattest = noise_line._flattest(torch.linspace(0, 1, len(light)), variance)
    assert flattest.mean().item() == pytest.approx(1e-4, rel=0.03)


@pytest.mark.parametrize(("n_blocks", "n_levels"), [(19, 1), (39, 1), (40, 2), (159, 7), (160, 8), (4000, 8)])
def test_levels_hold_twenty_blocks_at_least_and_are_eight_at_most(n_blocks, n_levels):
    light, variance = noise_line._flattest(torch.rand(n_blocks), torch.rand(n_blocks))
    assert len(light) == len(variance) == n_levels


def test_a_tenth_of_a_level_counts_as_flat():
    # Five levels of 20 blocks; in each, two blocks have variance 1.
    variance = torch.full((100,), 5.0)
    variance[::10] = 1.0
    _, flattest = noise_line._flattest(torch.arange(100.0), variance)
    torch.testing.assert_close(flattest, torch.full((5,), 1 / 0.539))


@pytest.mark.parametrize(("shot", "read"), [(2e-3, 1e-4), (0.0, 4e-4), (1e-3, 0.0)])
def test_shot_and_read_noise_are_measured(shot, read):
    ramp = torch.linspace(0.05, 0.9, 96).expand(3, 3, 3, 96, 96)
    slope, dark = noise_line.measure(LightField(noisy(ramp, shot, read)))
    middle = shot * 0.5 + read
    assert slope * 0.5 + dark == pytest.approx(middle, rel=0.05)
    assert slope == pytest.approx(shot, rel=0.1, abs=0.1 * middle)


def test_views_are_left_out_where_there_are_many_samples(monkeypatch):
    field, counts, blocks = LightField(torch.rand(9, 9, 1, 100, 100)), [], noise_line.blocks
    monkeypatch.setattr(noise_line, "blocks", lambda pictures: counts.append(len(pictures)) or blocks(pictures))
    for each in (field, field.crop(0, 0, 20, 20)):
        noise_line.measure(each)
    assert counts == [2**19 // 100**2, 81]


@pytest.mark.parametrize(("side", "is_measured"), [(9, False), (10, True)])
def test_views_need_room_for_a_block_and_its_filter(side, is_measured):
    assert (noise_line.measure(LightField(torch.rand(3, 3, 1, side, side) * 0.9)) != (0.0, 0.0)) is is_measured
