"""Fitted models: ordinary least squares where all is well, outliers aside, a prior where little is seen."""

import pytest
import torch

from lfref.captures import displacements

X = torch.stack([torch.ones(60), torch.linspace(-1, 3, 60)], -1).double()[:, None]
TRUTH = torch.tensor([0.4, -1.5], dtype=torch.float64)
EVEN = torch.ones(60, 1, 1, dtype=torch.float64)


def test_parameters_come_back_in_spite_of_outliers():
    seen = X @ TRUTH + 0.01 * torch.randn(60, 1, dtype=torch.float64)
    seen[::7] += 3
    found = displacements.fit_linear(X, seen, EVEN)
    torch.testing.assert_close(found.values, TRUTH, atol=0.03, rtol=0)
    assert found.scatter == pytest.approx(0.01, rel=0.6)
    assert found.effect == pytest.approx(float((X @ TRUTH).square().mean().sqrt()), rel=0.3)


def test_errors_are_those_of_repeated_trials():
    trials = [
        displacements.fit_linear(X, X @ TRUTH + 0.1 * torch.randn(60, 1, dtype=torch.float64), EVEN) for _ in range(60)
    ]
    scatter = torch.stack([one.values for one in trials]).std(0)
    told = torch.stack([one.errors for one in trials]).mean(0)
    assert bool(((told / scatter > 0.6) & (told / scatter < 1.6)).all())


def test_a_prior_holds_what_cannot_be_seen():
    ones = torch.ones(60, 1, 2, dtype=torch.float64)
    seen = 1 + 0.01 * torch.randn(60, 1, dtype=torch.float64)
    found = displacements.fit_linear(ones, seen, EVEN, torch.tensor([1e4, 1.0], dtype=torch.float64))
    torch.testing.assert_close(found.values, torch.tensor([0.0, 1.0]).double(), atol=0.02, rtol=0)
