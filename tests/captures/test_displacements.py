"""Displacements: patches with texture are chosen and read, displaced waves measured, models fitted without outliers."""

import pytest
import torch

from lfref import geometry
from lfref.captures import displacements
from lfref.captures.displacements import Patches
from lfref.simulator.effects import optics

PLACES = torch.cartesian_prod(*[geometry.angular_offsets(5)] * 2)


def test_patches_lie_where_texture_is_and_inside_all_views():
    grey = torch.zeros(160, 200)
    grey[40:120, 48:152] = torch.rand(80, 104)
    patches = displacements.choose_patches(grey, torch.full((160, 200), 1.5), PLACES, 3)
    assert len(patches.rows) >= 12
    for places, low, high in ((patches.rows, 40, 120), (patches.columns, 48, 152)):
        assert bool(((places >= low - 16) & (places <= high)).all())
    everywhere = displacements.choose_patches(torch.rand(160, 200), torch.full((160, 200), 6.0), PLACES, 3)
    assert float(everywhere.rows.min()) >= 12
    assert float(everywhere.rows.max()) <= 160 - 12 - 16


def test_patches_are_read_as_by_the_simulator():
    views = torch.rand(4, 2, 70, 80)
    patches = Patches(torch.tensor([20, 25]), torch.tensor([18, 40]), torch.zeros(2).double())
    moved = 3 * torch.rand(2, 4, 2, dtype=torch.float64) - 1.5
    samples = displacements.read_patches(views, patches, moved)
    assert samples.shape == (2, 4, 2, 20, 20)
    steps = torch.arange(20) - 2
    for k, i in ((0, 0), (1, 3)):
        rows = patches.rows[k] + moved[k, i, 0] + steps - (70 - 1) / 2
        columns = patches.columns[k] + moved[k, i, 1] + steps - (80 - 1) / 2
        down, across = (optics.matrix(*axis).float() for axis in ((rows, 70), (columns, 80)))
        torch.testing.assert_close(samples[k, i], down @ views[i] @ across.mT, atol=2e-6, rtol=0)


ALL = torch.ones(1, 4, dtype=torch.float64)


def waves(down, right):
    """A patch of one channel, its content moved, [h, w]."""
    y, x = (torch.arange(20.0, dtype=torch.float64)[:, None] - down, torch.arange(20.0, dtype=torch.float64) - right)
    return (0.5 + 0.2 * torch.sin(0.7 * y + 0.3 * x) + 0.1 * torch.cos(0.5 * x - 0.2 * y)).float()


def measured(observed):
    return torch.einsum("kcab,kicb->kica", observed.information.inverse(), observed.moments)[0, :, 0]


def test_displacements_of_waves_are_measured_whatever_their_brightness_and_contrast():
    truth = torch.tensor([[0.1, 0.0], [-0.1, 0.05], [0.05, -0.1], [-0.05, 0.05]], dtype=torch.float64)
    samples = torch.stack([waves(*shift.tolist()) for shift in truth])[None, :, None]
    torch.testing.assert_close(measured(displacements.observe(samples, ALL)), truth, atol=3e-3, rtol=0)
    contrasts = torch.tensor([0.5, 1.0, 1.2, 0.9])[None, :, None, None, None]
    moved = measured(displacements.observe(0.1 + contrasts * samples, ALL))
    torch.testing.assert_close(moved - moved.mean(0), truth - truth.mean(0), atol=6e-3, rtol=0)


X = torch.stack([torch.ones(60), torch.linspace(-1, 3, 60)], -1).double()[:, None]
TRUTH = torch.tensor([0.4, -1.5], dtype=torch.float64)
EVEN = torch.ones(60, 1, 1, dtype=torch.float64)


def test_parameters_are_fitted_in_spite_of_outliers():
    observations = X @ TRUTH + 0.01 * torch.randn(60, 1, dtype=torch.float64)
    observations[::7] += 3
    fit = displacements.fit_linear(X, observations, EVEN)
    torch.testing.assert_close(fit.values, TRUTH, atol=0.03, rtol=0)
    assert fit.scatter == pytest.approx(0.01, rel=0.6)
    assert fit.effect == pytest.approx(float((X @ TRUTH).square().mean().sqrt()), rel=0.3)


def test_observations_without_information_change_nothing():
    # Most patches of a colour may be flat: the typical residual is then that of the others.
    observations = X @ TRUTH + 0.01 * torch.randn(60, 1, dtype=torch.float64)
    flat = torch.cat([EVEN, torch.zeros(200, 1, 1, dtype=torch.float64)])
    among_flat = displacements.fit_linear(
        torch.cat([X, X.new_ones(200, 1, 2)]), torch.cat([observations, X.new_ones(200, 1)]), flat
    )
    for value, expected in zip(among_flat, displacements.fit_linear(X, observations, EVEN), strict=True):
        torch.testing.assert_close(torch.as_tensor(value), torch.as_tensor(expected))


def test_an_outlier_pulls_by_half_of_its_weight_at_two_standard_deviations():
    # All observations but one lie one standard deviation from 0, that one two: the pulls cancel at the fitted mean.
    observations = torch.tensor([1.0, -1.0] * 50 + [2.0]).double()[:, None]
    ones = torch.ones(101, 1, 1, dtype=torch.float64)
    value = displacements.fit_linear(ones, observations, ones).values
    pulls = (observations - value) / (1 + ((observations - value) / 2).square())
    assert float(pulls.sum()) == pytest.approx(0, abs=0.02)


def test_errors_are_those_of_repeated_trials():
    noise = 0.1 * torch.randn(60, 60, 1, dtype=torch.float64)
    trials = [displacements.fit_linear(X, X @ TRUTH + one, EVEN) for one in noise]
    scatter = torch.stack([fit.values for fit in trials]).std(0)
    errors = torch.stack([fit.errors for fit in trials]).mean(0)
    assert bool(((errors / scatter > 0.6) & (errors / scatter < 1.6)).all())


def test_a_prior_holds_what_the_observations_leave_open():
    ones = torch.ones(60, 1, 2, dtype=torch.float64)
    observations = 1 + 0.01 * torch.randn(60, 1, dtype=torch.float64)
    fit = displacements.fit_linear(ones, observations, EVEN, torch.tensor([1e4, 1.0], dtype=torch.float64))
    torch.testing.assert_close(fit.values, torch.tensor([0.0, 1.0]).double(), atol=0.02, rtol=0)
