import pytest
import torch

from lfref.refocus import batches
from lfref.refocus.fourier import layer_energies
from tests.refocus.conftest import shifted_views, texture

FULL = batches.checked_weights(None, (5, 5))


def layered(*disparities, grid=(5, 5)):
    return sum(shifted_views(texture(3, 48, 60), d, grid) for d in disparities) / len(disparities)


@pytest.mark.parametrize("disparities", [(0.6,), (-1.25, 0.5), (-3.0, -1.0, 1.5)])
def test_finds_the_range_of_the_disparities(disparities):
    made = layer_energies.estimate_energies(layered(*disparities), 9, FULL)
    assert made.disparities.shape == made.shares.shape == (9,)
    assert min(disparities) - 0.65 <= made.disparities[0] <= min(disparities)
    assert max(disparities) <= made.disparities[-1] <= max(disparities) + 0.65


def test_most_of_the_light_is_at_the_layers_next_to_the_disparities():
    disparities, shares = layer_energies.estimate_energies(layered(-1.25, 0.5), 12, FULL)
    step = disparities[1] - disparities[0]
    near = ((disparities + 1.25).abs() < step) | ((disparities - 0.5).abs() < step)
    assert shares[near].sum() > 0.9
    assert abs(float(shares.sum()) - 1) < 1e-9


def test_views_of_weight_0_are_not_read():
    views, weights = layered(0.5), torch.ones(5, 5)
    weights[0, 0] = 0
    spoilt = views.clone()
    spoilt[0, 0] = torch.nan
    aperture = batches.checked_weights(weights, (5, 5))
    for clean, dirty in zip(
        layer_energies.estimate_energies(views, 5, aperture),
        layer_energies.estimate_energies(spoilt, 5, aperture),
        strict=True,
    ):
        assert torch.equal(clean, dirty)


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_flat_views_have_some_layers_all_the_same(level):
    disparities, shares = layer_energies.estimate_energies(torch.full((5, 5, 3, 16, 18), level), 4, FULL)
    assert bool(disparities.isfinite().all())
    assert bool((shares > 0).all())


@pytest.mark.parametrize("shape", [(1, 1, 1, 1, 1), (1, 3, 1, 4, 5), (5, 5, 1, 6, 6)])
def test_small_fields_have_layers_that_they_can_be_shifted_by(shape):
    aperture = batches.checked_weights(None, shape[:2])
    disparities, _ = layer_energies.estimate_energies(torch.rand(shape), 3, aperture)
    assert bool(disparities.isfinite().all())
