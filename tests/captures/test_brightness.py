"""Brightness from view to view: known gains are measured; clipped, dark and hidden windows are unknown."""

import dataclasses

import pytest
import torch

from lfref.captures import brightness
from lfref.captures.brightness import Ratios, block_means

from .scenes import ODD, clean, ratios


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_a_block_with_a_clipped_sample_is_unknown(dtype):
    images = torch.full((2, 3, 8, 12), 0.5, dtype=dtype)
    images[1, 2, 5, 6] = 0.9
    expected = torch.full((2, 3, 2, 3), 0.5, dtype=dtype)
    expected[1, 2, 1, 1] = torch.nan
    means = block_means(images, 4, torch.tensor([0.8, 0.8, 0.9]))
    torch.testing.assert_close(means, expected, equal_nan=True)


def found_in(field):
    return brightness.find_exposure(ratios(field))


@pytest.mark.parametrize("name", ["shards", "gloss"])
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


@pytest.mark.parametrize("name", [*ODD, "lattice", "floor"])
def test_a_field_of_equal_exposures_is_left(name):
    assert isinstance(found_in(clean(name)), str)


def certain_gains(levels, errors, scatter=0.0):
    return brightness.certain_gains(levels, errors, torch.full_like(levels, scatter))


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
    torch.testing.assert_close(certain_gains(levels, torch.full_like(levels, error)), expected)


@pytest.mark.parametrize(("scatter", "gains"), [(0.06, 2), (0.068, 0), (0.044, 2), (0.036, 3)])
def test_gains_that_scatter_explains_are_left(scatter, gains):
    # 1.5 times the scatter shows; beside that half of the scatter is enough.
    levels = torch.tensor([[[0.1], [0.1], [0.02]]])
    assert int((certain_gains(levels, torch.zeros(1, 3, 1), scatter) != 1).sum()) == gains


def even_ratios(log, shape):
    """Ratios of these logarithms [V, U, C, n] at even places."""
    known = torch.ones(*log.shape[:2], log.shape[-1], dtype=torch.bool)
    return Ratios(log, known, torch.zeros(2, *known.shape), torch.zeros(2, *known.shape[:2], 1), shape, (0, 0))


def test_errors_follow_repeated_trials_where_windows_of_one_tile_err_alike():
    trials = 0.05 * torch.randn(15, 10, 3, 5, 5).repeat_interleave(4, 3).repeat_interleave(4, 4).flatten(3)
    level, error, _ = brightness.levels(even_ratios(trials, (20, 20)))
    # The errors leave out how much less outliers count: about half of the true ones, which `SURE` allows for.
    assert 0.4 < float(error.mean() / level.std()) < 0.8
    # Larger tiles would give about the same mean from too few numbers.
    assert float(error.std() / error.mean()) < 0.25
