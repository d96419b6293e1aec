"""The smooth map: the solution of its equations, and what spreads into regions that know nothing."""

import pytest
import torch

from lfref.refocus.disparity import matching


def solved(target, trust, across, down):
    """By a dense system of equations."""
    height, width = target.shape
    matrix, place = torch.diag(trust.flatten()), torch.arange(height * width).reshape(height, width)
    pairs = [(place[:, :-1], place[:, 1:], across[:, :-1]), (place[:-1], place[1:], down[:-1])]
    for first, second, tie in pairs:
        for a, b, t in zip(first.flatten(), second.flatten(), tie.flatten(), strict=True):
            matrix[a, a] += t
            matrix[b, b] += t
            matrix[a, b] -= t
            matrix[b, a] -= t
    return torch.linalg.solve(matrix, (trust * target).flatten()).reshape(height, width)


@pytest.mark.parametrize("size", [(6, 7), (1, 9), (8, 1)])
def test_enough_rounds_solve_the_equations(size, monkeypatch):
    monkeypatch.setattr(matching, "ROUNDS", 2000)
    target, trust, across, down = torch.rand(4, *size, dtype=torch.float64)
    torch.testing.assert_close(
        matching.relax(target, trust, across, down), solved(target, trust, across, down), atol=1e-6, rtol=0
    )


def test_what_edges_know_fills_what_is_between():
    target, trust, ties = torch.rand(20, 20), torch.zeros(20, 20), torch.full((20, 20), 1.0)
    target[:, 0] = target[:, -1] = target[0] = target[-1] = 0.7
    trust[:, 0] = trust[:, -1] = trust[0] = trust[-1] = 1e6
    before = (target - 0.7).abs().mean()
    assert float((matching.relax(target, trust, ties, ties) - 0.7).abs().mean()) < 0.3 * before


def test_nothing_passes_where_there_are_no_ties():
    target, none = torch.rand(9, 11, dtype=torch.float64), torch.zeros(9, 11)
    torch.testing.assert_close(matching.relax(target, none, none, none), target)
