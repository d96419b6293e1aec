"""What matching looks at: views of a weight, and those in the middle."""

import math

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus.disparity.cost_volume import grey_views


@pytest.mark.parametrize(("grid", "n_middle"), [((3, 5), 1), ((2, 3), 2), ((4, 4), 4), ((1, 6), 2)])
def test_the_middle_is_one_view_or_those_around_it(grid, n_middle):
    light = grey_views(torch.rand(*grid, 3, 6, 7), torch.ones(grid))
    assert len(light.middle) == n_middle
    assert abs(light.positions[light.middle].mean(0)).max() == 0


def test_colours_are_averaged_and_integers_scaled():
    views = torch.randint(0, 255, (3, 3, 3, 5, 6), dtype=torch.uint8)
    light = grey_views(views, torch.ones(3, 3))
    torch.testing.assert_close(torch.from_numpy(light.samples), (views.float() / 255).mean(2).flatten(0, 1))
    torch.testing.assert_close(light.central, (views[1, 1].float() / 255).mean(0))


def test_views_of_weight_0_are_not_looked_at_whatever_they_hold():
    views, aperture = torch.rand(3, 3, 1, 5, 6), torch.ones(3, 3)
    views[1, 1], aperture[1, 1] = math.nan, 0
    light = grey_views(views, aperture)
    assert len(light.samples) == 8
    # The four beside the missing one.
    assert sorted(map(tuple, light.positions[light.middle].tolist())) == [(-1, 0), (0, -1), (0, 1), (1, 0)]


def test_what_is_not_finite_and_single_views_are_refused():
    views = torch.rand(2, 2, 1, 5, 6)
    with pytest.raises(InputError, match="more than one view"):
        grey_views(views, torch.tensor([[1.0, 0], [0, 0]]))
    views[0, 1, 0, 2, 3] = math.inf
    with pytest.raises(InputError, match="finite"):
        grey_views(views, torch.ones(2, 2))
