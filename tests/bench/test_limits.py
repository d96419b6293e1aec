import functools

import pytest
import torch

from lfref.bench import limits


def test_multiply_adds_of_the_papers_case():
    views = torch.empty(7, 7, 3, 375, 540, device="meta")
    assert limits.multiply_adds(views, 16) == 16 * 375 * 540 * 3 * (7 * 7 * 2 + 7 * 2)


def test_limits_are_shares_of_a_copy_and_of_a_matrix_product(monkeypatch):
    seconds = {"copy_": 0.5, "mm": 2.0}

    def fastest(run: functools.partial, device):
        run()
        return seconds[run.func.__name__]

    monkeypatch.setattr(limits, "SIDE", 16)
    monkeypatch.setattr(limits, "_fastest", fastest)
    views = torch.rand(3, 4, 1, 5, 6)
    found = limits.shift_and_sum_limits(views, 6)
    assert found.bytes_s == pytest.approx(0.5 * (12 + 6) / 24)
    assert found.arithmetic_s == pytest.approx(2.0 * 6 * 30 * 2 * (12 + 3) / 16**3)


def test_limits_can_be_measured(monkeypatch):
    monkeypatch.setattr(limits, "SIDE", 64)
    found = limits.shift_and_sum_limits(torch.rand(3, 3, 1, 20, 20), 4)
    assert found.bytes_s > 0
    assert found.arithmetic_s > 0
