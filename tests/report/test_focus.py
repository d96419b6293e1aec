import numpy as np
import pytest
import torch

from lfref.errors import InputError
from lfref.report import results


def drawn(slopes: torch.Tensor, confidence: torch.Tensor):
    figure = results.focus_map(slopes, confidence)
    _, shown = figure.axes[0].images
    return figure, shown


@pytest.mark.parametrize("most", [1.0, 0.4, 0.1])
def test_colour_is_the_slope_and_opacity_the_confidence_beside_that_of_most(most):
    slopes = torch.linspace(-1, 0.5, 21).reshape(3, 7)
    confidence = torch.linspace(0, most, 21).reshape(3, 7)
    figure, shown = drawn(slopes, confidence)
    np.testing.assert_allclose(shown.get_array(), slopes, atol=1e-7)
    opaque = max(0.9 * most, 0.25)  # nothing that is hardly sure is opaque
    np.testing.assert_allclose(shown.get_alpha(), (confidence / opaque).clamp(max=1), atol=1e-6)
    assert figure.axes[1].get_ylabel() == "slope, px per view step"


def test_the_scale_is_that_of_pixels_that_can_tell():
    slopes = torch.full((10, 10), 0.25)
    slopes[:, 5:] = torch.linspace(-1, 1, 50).reshape(10, 5)
    slopes[0, 0] = 99  # nothing can be told here
    confidence = torch.full((10, 10), 0.0)
    confidence[:, 5:] = 0.9
    _, shown = drawn(slopes, confidence)
    low, high = shown.get_clim()
    assert -1 <= low < -0.9
    assert high < 1.1


def test_one_slope_everywhere_can_be_drawn():
    _, shown = drawn(torch.full((4, 5), 0.5), torch.zeros(4, 5))
    assert shown.get_clim() == (0.5, 0.5)


@pytest.mark.parametrize("shape", [(4,), (1, 4, 5), (5, 4)])
def test_maps_that_do_not_fit_are_refused(shape):
    with pytest.raises(InputError, match=r"must be \[H, W\]"):
        results.focus_map(torch.zeros(shape), torch.zeros(4, 5))


def test_a_few_outliers_do_not_stretch_the_scale_however_sure_they_are():
    slopes = torch.linspace(-1, 1, 1000).reshape(20, 50)
    confidence = torch.full((20, 50), 0.6)
    slopes[0, :10], confidence[0, :10] = 40, 0.99
    _, shown = drawn(slopes, confidence)
    low, high = shown.get_clim()
    assert -1 < low < -0.9
    assert 0.9 < high < 1.1


def test_what_is_hardly_sure_hardly_counts():
    slopes = torch.linspace(-1, 1, 1000).reshape(20, 50)
    slopes[:2] = 5
    confidence = torch.full((20, 50), 0.9)
    confidence[:2] = 0.12
    _, shown = drawn(slopes, confidence)
    assert shown.get_clim()[1] < 1.1
