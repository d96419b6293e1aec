"""Random numbers of an effect: they depend on the seed and the effect's name, on nothing else."""

import itertools

import pytest
import torch

from lfref.simulator.effects import effect


def test_seed_and_name_fix_the_draws():
    keys = list(itertools.product((0, 1, 2**40), ("noise", "misalignment", "esion")))
    draws = [torch.rand(4, generator=effect.generator(*key)) for key in keys]
    for (i, first), (j, second) in itertools.product(enumerate(draws), repeat=2):
        assert torch.equal(first, second) == (i == j)
    for key, first in zip(keys, draws, strict=True):
        assert torch.equal(torch.rand(4, generator=effect.generator(*key)), first)


def test_draws_take_on_type_and_are_standard_normal():
    draws = effect.normal((500, 400), effect.generator(0, "noise"), torch.zeros((), dtype=torch.float64))
    assert draws.dtype == torch.float64
    assert abs(float(draws.mean())) < 0.01
    assert float(draws.std()) == pytest.approx(1, abs=0.01)


def test_draws_are_the_same_in_any_type():
    single, double = (
        effect.normal((7,), effect.generator(3, "noise"), torch.zeros((), dtype=dtype))
        for dtype in (torch.float32, torch.float64)
    )
    assert torch.equal(single.double(), double)
