"""Exposure: gains of views and colours are estimated and undone; views that differ by what they show keep theirs."""

import dataclasses

import pytest
import torch

from lfref.captures import exposure
from lfref.captures.brightness import Ratios
from lfref.lightfield import LightField

from .scenes import ODD, clean, ratios


def found_in(field):
    return exposure.find(ratios(field))


@pytest.mark.parametrize("name", ["shards", "gloss", "leaves"])
def test_gains_of_views_and_colours_are_estimated(name):
    field, gains = clean(name), torch.exp(0.1 * torch.randn(7, 7, 3))
    gains[3, 3] = 1
    changed = dataclasses.replace(field, views=0.6 * field.views * gains[..., None, None])
    defect = found_in(changed)
    error = (defect.gains / gains - 1).abs()
    assert float(error.median()) < 0.003
    assert float(error.max()) < 0.015
    restored = defect.corrected(changed).views / (0.6 * field.views).clamp(min=1e-3)
    assert float((restored.mean((3, 4)) - 1).abs().median()) < 0.003


def test_one_bright_view_is_the_only_one_that_changes():
    field = clean("shards")
    views = field.views.clone()
    views[1, 5] *= 1.06
    changed = LightField(views)
    defect = found_in(changed)
    corrected = defect.corrected(changed).views
    is_changed = (corrected != field.views).flatten(2).any(2)
    assert is_changed.nonzero().tolist() == [[1, 5]]
    torch.testing.assert_close(corrected[1, 5], field.views[1, 5], rtol=0.003, atol=0)
    assert "1 of 49 views is 1.000 to 1.0" in defect.summary()


@pytest.mark.parametrize("name", [*ODD, "lattice", "floor"])
def test_a_field_of_equal_exposures_is_left(name):
    assert found_in(clean(name)).reason_to_skip() is not None


def test_a_black_view_is_not_brightened():
    views = clean("shards").views.clone()
    views[0, 0] *= 0.01
    assert bool((found_in(LightField(views)).gains[0, 0] == 1).all())


def test_black_views_cannot_be_compared():
    assert found_in(LightField(torch.zeros(3, 3, 3, 40, 60))).reason_to_skip() is not None


@pytest.mark.parametrize(
    ("level", "error", "is_corrected"),
    [
        (0.065, 0.01, True),  # six standard errors
        (0.055, 0.01, False),
        (-0.022, 0.0, True),
        (-0.018, 0.0, False),
        (-1.4, 0.0, True),
        (-1.6, 0.0, False),  # another defect
    ],
)
def test_a_gain_counts_if_it_is_certain_and_shows(level, error, is_corrected):
    levels = torch.zeros(3, 3, 1)
    levels[0, 0] = level
    expected = torch.ones(3, 3, 1).double()
    expected[0, 0] = torch.tensor(level if is_corrected else 0.0).exp()
    torch.testing.assert_close(exposure.certain_gains(levels, torch.full_like(levels, error)), expected)


def test_smaller_gains_are_corrected_beside_one_that_shows():
    gains = exposure.certain_gains(torch.tensor([[[0.1], [0.0045], [0.0035]]]), torch.zeros(1, 3, 1))
    assert (gains != 1).flatten().tolist() == [True, True, False]


def even_ratios(log, shape):
    """Ratios of these logarithms [V, U, C, n] at even places."""
    known = torch.ones(*log.shape[:2], log.shape[-1], dtype=torch.bool)
    return Ratios(log, known, torch.zeros(2, *known.shape), torch.zeros(2, *known.shape[:2], 1), shape, (0, 0))


@pytest.mark.parametrize(("n", "is_enough"), [(20, False), (28, True)])
def test_a_gain_needs_two_dozen_windows(n, is_enough):
    log = torch.zeros(1, 3, 1, n)
    log[0, 2] = 0.1
    assert (exposure.find(even_ratios(log, (4, n // 4))).reason_to_skip() is None) == is_enough


def test_errors_follow_repeated_trials_where_windows_of_one_tile_err_alike():
    trials = 0.05 * torch.randn(15, 10, 3, 5, 5).repeat_interleave(4, 3).repeat_interleave(4, 4).flatten(3)
    level, error = exposure.levels(even_ratios(trials, (20, 20)))
    # The errors leave out how much less outliers count: about half of the true ones, which `SURE` allows for.
    assert 0.4 < float(error.mean() / level.std()) < 0.8
    # Larger tiles would give about the same mean from too few numbers.
    assert float(error.std() / error.mean()) < 0.25
