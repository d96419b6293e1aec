"""Quantisation: values on a grid of 2^bits, at most half a step away."""

import pytest
import torch

from lfref.simulator.effects.response import Quantisation, quantised

from .conftest import GRID


@pytest.mark.parametrize("bits", [1, 2, 8, 12, 20])
def test_the_error_is_half_a_step_at_most(bits):
    values, steps = torch.rand(100_000) * 1.2 - 0.1, 2**bits - 1
    made = quantised(values, bits)
    assert float((made - values).abs().max()) <= 0.5 / steps + 1e-7
    on_grid = made.double() * steps
    torch.testing.assert_close(on_grid, on_grid.round(), atol=steps * 2e-7, rtol=0)


@pytest.mark.parametrize("bits", [1, 3, 8])
def test_from_0_to_1_there_are_as_many_values_as_bits_tell_apart(bits):
    made = quantised(torch.linspace(0, 1, 5000), bits)
    assert len(made.unique()) == 2**bits
    assert made[0] == 0
    assert made[-1] == 1


def test_it_is_idempotent():
    made = quantised(torch.rand(1000), 8)
    assert torch.equal(quantised(made, 8), made)


def test_no_bits_are_inert():
    assert Quantisation().inert(GRID) == "samples are not rounded"
    assert Quantisation(16).inert(GRID) is None
