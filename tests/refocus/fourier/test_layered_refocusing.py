import math

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import apertures
from lfref.refocus.fourier.disparity_layers import disparity_layers, refocus_by_layers
from lfref.refocus.fourier.exact import exact_fourier
from tests.refocus.conftest import shifted_views, texture

SLOPES = [-2.0, -0.5, 0.0, 0.8]
DISPARITIES = [-1.0, -0.25, 0.5]


def scene(*disparities, grid=(5, 5)):
    return sum(shifted_views(texture(3, 40, 45), d, grid) for d in disparities) / len(disparities)


@pytest.mark.parametrize("weights", [None, apertures.disc((5, 5)), torch.arange(25.0).reshape(5, 5)])
def test_cells_without_area_are_exact_refocusing(weights):
    views = torch.rand(5, 5, 2, 20, 23, dtype=torch.float64)
    made = refocus_by_layers(views, SLOPES, fill=0.0, weights=weights, border="wrap")
    torch.testing.assert_close(made, exact_fourier(views, SLOPES, weights), atol=1e-12, rtol=0)


def test_layers_at_the_disparities_leave_nothing_to_the_middle_one():
    views = scene(-1.0, 0.5)
    made = refocus_by_layers(views, SLOPES, DISPARITIES, ridge=1e-9, border="wrap")
    expected = disparity_layers(views, DISPARITIES, ridge=1e-9, border="wrap").refocus(SLOPES)
    torch.testing.assert_close(made, expected, atol=1e-4, rtol=0)


def test_a_plane_in_focus_is_as_sharp_as_its_texture(plane):
    views, image = plane(0.5)
    made = refocus_by_layers(views, [0.5], DISPARITIES, border="wrap")[0]
    torch.testing.assert_close(made, image, atol=2e-3, rtol=0)


def test_copies_of_what_is_out_of_focus_go():
    # Nine by nine views in each view's cell are the truth.
    image, slope, disparity = texture(1, 24, 26), -3.0, 0.2
    truth = exact_fourier(shifted_views(image, disparity / 9, (27, 27)), [slope / 9])
    views = shifted_views(image, disparity, (3, 3))
    points, areas = (
        (refocus_by_layers(views, [slope], [disparity], fill=fill, border="wrap") - truth).square().mean()
        for fill in (0.0, 1.0)
    )
    assert areas < points / 50


def test_found_disparities_do_nearly_as_well_as_the_true_ones():
    views = scene(-1.0, 0.5)
    truth = refocus_by_layers(views, SLOPES, [-1.0, 0.5], ridge=1e-6)
    found, points = (refocus_by_layers(views, SLOPES, fill=fill) for fill in (1.0, 0.0))
    assert (found - truth).square().mean() < (points - truth).square().mean() / 30


def test_brightness_stays():
    views = scene(-1.0, 0.5)
    stack = refocus_by_layers(views, SLOPES, border="wrap")
    torch.testing.assert_close(stack.mean((-2, -1)), views.mean((0, 1, 3, 4)).expand(4, 3), atol=1e-6, rtol=0)


@pytest.mark.parametrize("fill", [0.0, 0.5, 1.0, 2.0])
def test_a_constant_field_stays_constant(fill):
    stack = refocus_by_layers(torch.full((5, 4, 3, 20, 21), 0.7), SLOPES, fill=fill)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.7), atol=1e-6, rtol=0)


def test_each_light_field_of_a_batch_has_layers_of_its_own():
    views = torch.stack([scene(-1.0), scene(0.75)])
    stacks = refocus_by_layers(views, SLOPES)
    for stack, field in zip(stacks, views, strict=True):
        torch.testing.assert_close(stack, refocus_by_layers(field, SLOPES), atol=1e-12, rtol=0)


def test_opposite_borders_do_not_mix():
    views = torch.zeros(5, 5, 1, 24, 30)
    views[..., :4] = 1
    edge, wrap = (refocus_by_layers(views, [-2.0], [0.0], border=border)[0, 0, :, -1] for border in ("edge", "wrap"))
    assert edge.abs().max() < 0.05 < wrap.max()


@pytest.mark.parametrize("fill", [-1.0, math.nan])
def test_refuses_cells_without_a_width(fill):
    with pytest.raises(InputError, match="fill"):
        refocus_by_layers(torch.rand(3, 3, 1, 12, 13), [0.5], fill=fill)
