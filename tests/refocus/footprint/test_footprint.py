import math

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import footprint

VIEWS = torch.zeros(2, 5, 5, 3, 8, 9)
SLOPES = torch.tensor([-1.0, 0.5], dtype=torch.float64)


def test_a_box_is_as_wide_as_light_moves_within_a_cell():
    widths = footprint.checked(0.5, -0.2, VIEWS).widths(SLOPES)
    torch.testing.assert_close(widths.abs(), torch.tensor([0.4, 0.35], dtype=torch.float64))


def test_a_map_makes_a_width_for_every_pixel():
    disparity = torch.rand(8, 9)
    cell = footprint.checked(2, disparity, VIEWS)
    assert cell.varies(SLOPES)
    torch.testing.assert_close(cell.widths(SLOPES)[0, 1], 2 * (0.5 - disparity))
    assert cell.widths(SLOPES).shape == (1, 2, 8, 9)


def test_every_light_field_may_have_a_map_of_its_own():
    disparity = torch.rand(2, 8, 9)
    widths = footprint.checked(1, disparity, VIEWS).widths(SLOPES)
    torch.testing.assert_close(widths, SLOPES.float()[:, None, None] - disparity[:, None])


def test_slopes_may_differ_from_pixel_to_pixel():
    slopes = torch.rand(3, 8, 9, dtype=torch.float64)
    cell = footprint.checked(1, torch.tensor(0.25), VIEWS)
    assert cell.varies(slopes)
    assert not cell.varies(SLOPES)
    torch.testing.assert_close(cell.widths(slopes), slopes[None] - 0.25)


def test_the_response_is_of_width_times_frequency():
    response = footprint.checked(1, 0.5, VIEWS).responses(SLOPES, torch.tensor([0.0, 0.5]))
    expected = torch.tensor([[[1, 2 / (0.75 * 2 * math.pi) * math.sin(0.75 * math.pi)]], [[1, 1]]])
    torch.testing.assert_close(response, expected.double())


def test_cells_whose_blur_varies_let_all_frequencies_pass():
    response = footprint.checked(1, torch.zeros(8, 9), VIEWS).responses(SLOPES, torch.tensor([0.0, 0.5]))
    assert bool((response == 1).all())


@pytest.mark.parametrize(
    ("fill", "disparity", "message"),
    [
        (-1, 0.0, "fill must be finite and >= 0"),
        (math.nan, 0.0, "fill must be finite and >= 0"),
        (math.inf, 0.0, "fill must be finite and >= 0"),
        ("1", 0.0, "fill must be finite and >= 0"),
        (1, math.nan, "disparity must be finite"),
        (1, torch.full((8, 9), math.inf), "disparity must be finite"),
        (1, torch.zeros(9, 8), "disparity must be a number or a map"),
        (1, torch.zeros(3, 8, 9), "disparity must be a number or a map"),
        (1, torch.zeros(1), "disparity must be a number or a map"),
    ],
)
def test_cells_that_cannot_be_are_refused(fill, disparity, message):
    with pytest.raises(InputError, match=message):
        footprint.checked(fill, disparity, VIEWS)


def test_a_box_wider_than_the_picture_is_refused():
    with pytest.raises(InputError, match=r"at most the picture's 9 px; got 16 px"):
        footprint.checked(8, 1.0, VIEWS).widths(SLOPES)
