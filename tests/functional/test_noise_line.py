"""The noise line: spectra of blocks, their quiet part, and the line below which no level of light lies far."""

import math

import pytest
import torch
from torch.nn import functional as F

from lfref.functional import noise_line
from lfref.lightfield import LightField


def noisy(light, shot, read, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return light + (shot * light + read).sqrt() * torch.randn(light.shape, generator=generator)


def test_white_noise_has_its_variance_at_all_frequencies():
    pictures = noisy(torch.full((40, 130, 130), 0.5), 0.0, 1e-4)
    light, variance = noise_line.blocks(pictures)
    assert variance.shape == (40 * 16**2, 14)
    torch.testing.assert_close(variance.mean(0), torch.full((14,), 1e-4), rtol=0.05, atol=0)
    assert float(light.mean()) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.1])
@pytest.mark.parametrize("period", [6.0, 9.0, 30.0])
def test_stripes_are_hardly_taken_for_noise(angle, period):
    # Pixels average over their squares, as those of a camera.
    y, x = torch.arange(384.0)[:, None] / 4, torch.arange(384.0) / 4
    turns = (x * math.cos(angle) + y * math.sin(angle)) / period
    pixels = F.avg_pool2d((0.5 + 0.4 * (2 * math.pi * turns).sin().sign())[None], 4)
    stripes = pixels.expand(3, 3, 1, 96, 96)
    shot, read = noise_line.measure(LightField(noisy(stripes, 0.0, 1e-4)))
    # The variance of the stripes is .15; along the axes they leave most frequencies to the noise alone.
    assert 0.7e-4 < 0.5 * shot + read < (2e-4 if angle == 0 or period > 9 else 2.5e-3)


@pytest.mark.parametrize(("shot", "read"), [(2e-3, 1e-4), (0.0, 4e-4), (1e-3, 0.0)])
def test_shot_and_read_noise_are_measured(shot, read):
    ramp = torch.linspace(0.05, 0.9, 96).expand(3, 3, 3, 96, 96)
    slope, dark = noise_line.measure(LightField(noisy(ramp, shot, read)))
    middle = shot * 0.5 + read
    assert slope * 0.5 + dark == pytest.approx(middle, rel=0.05)
    assert slope == pytest.approx(shot, rel=0.1, abs=0.1 * middle)
