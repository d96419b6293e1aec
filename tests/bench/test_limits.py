import functools

import pytest
import torch

from lfref.bench import cost, timing


def test_multiply_adds_of_the_papers_case():
    views = torch.empty(7, 7, 3, 375, 540, device="meta")
    assert cost.multiply_adds(views, 16) == 16 * 375 * 540 * 3 * (7 * 7 * 2 + 7 * 2)


def test_limits_are_shares_of_a_copy_and_of_a_matrix_product(monkeypatch):
    seconds = {"copy_": 0.5, "mm": 2.0}

    def fastest(run: functools.partial, device):
        run()
        return seconds[run.func.__name__]

    monkeypatch.setattr(cost, "SIDE", 16)
    monkeypatch.setattr(cost, "_fastest", fastest)
    views = torch.rand(3, 4, 1, 5, 6)
    found = cost.shift_and_sum_limits(views, 6)
    assert found.bytes_s == pytest.approx(0.5 * (12 + 6) / 24)
    assert found.arithmetic_s == pytest.approx(2.0 * 6 * 30 * 2 * (12 + 3) / 16**3)


def test_the_fastest_of_all_rounds_counts(monkeypatch):
    monkeypatch.setattr(cost, "SIDE", 64)
    taken = iter([0.5, 0.4, 0.2, 0.3, 0.6, 7.0, 5.0, 8.0, 6.0, 9.0])
    monkeypatch.setattr(timing, "seconds", lambda run, device: next(taken))
    found = cost.shift_and_sum_limits(torch.rand(3, 3, 1, 20, 20), 9)
    assert found.bytes_s == pytest.approx(0.2)
    assert found.arithmetic_s == pytest.approx(5.0 * 9 * 400 * 2 * (9 + 3) / 64**3)
