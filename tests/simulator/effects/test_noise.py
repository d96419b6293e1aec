"""Noise: its mean and variance at known radiances are those of the model, sample by sample independent."""

import pytest
import torch

from lfref.simulator.effects.recording import Noise, noisy

N = 400_000
LEVELS = [0.0, 0.1, 0.5, 2.0]


def applied(effect, views, seed=0):
    return effect.apply(views, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(("shot", "read"), [(0.01, 0.0), (0.0, 4e-4), (0.02, 1e-3)])
def test_variance_is_a_x_plus_b_and_the_mean_is_x(shot, read):
    for seed, level in enumerate(LEVELS):
        result = applied(Noise(shot, read), torch.full((N,), level), seed).double()
        variance = shot * level + read
        assert float(result.var()) == pytest.approx(variance, rel=0.02)
        assert float(result.mean()) == pytest.approx(level, abs=5 * (variance / N) ** 0.5 + 1e-7)


def test_samples_are_independent():
    result = applied(Noise(read=1.0), torch.zeros(4, 4, 3, 120, 120))
    for axis in range(result.ndim):
        first, second = result.narrow(axis, 0, result.shape[axis] - 1), result.narrow(axis, 1, result.shape[axis] - 1)
        assert abs(float((first * second).mean())) < 0.01


def test_black_and_what_lies_below_have_read_noise_alone():
    views = torch.tensor([-0.5, 0.0])
    assert torch.equal(noisy(views, 0.3, 0.0, torch.ones(2)), views)
    torch.testing.assert_close(noisy(views, 0.3, 0.04, torch.ones(2)), views + 0.2)
