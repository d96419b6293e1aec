"""Boxes by PyTorch's operations against the definition, pixel by pixel."""

import pytest
import torch

from lfref.refocus import footprint, footprint_blur
from lfref.refocus.sampling import BORDERS


def slow_box(image, widths, border):
    """Each pixel's own box, one sample at a time; [H, W] each."""
    height, width = image.shape
    blurred = torch.zeros_like(image)
    for y in range(height):
        for x in range(width):
            weights = footprint.taps(float(widths[y, x]))
            radius = len(weights) // 2
            for k, down in enumerate(weights):
                for m, across in enumerate(weights):
                    blurred[y, x] += down * across * read(image, y + k - radius, x + m - radius, border)
    return blurred


def read(image, y, x, border):
    height, width = image.shape
    if border == "wrap":
        return image[y % height, x % width]
    inside = 0 <= y < height and 0 <= x < width
    if border in ("zero", "renormalize") and not inside:
        return 0.0
    return image[min(max(y, 0), height - 1), min(max(x, 0), width - 1)]


@pytest.mark.parametrize("border", list(BORDERS))
@pytest.mark.parametrize("width", [0.0, 0.3, 1.0, 2.7, 13.0])
def test_equals_the_slow_reference(border, width):
    images = torch.rand(2, 7, 9, dtype=torch.float64)
    blurred = footprint_blur.boxed(images, width, BORDERS[border])
    for image, result in zip(images, blurred, strict=True):
        slow = slow_box(image, torch.full((7, 9), width, dtype=torch.float64), border)
        torch.testing.assert_close(result, slow, atol=1e-12, rtol=0)


@pytest.mark.parametrize("border", list(BORDERS))
def test_at_a_level_a_map_is_its_box(border):
    planes, level = torch.rand(2, 3, 7, 9, dtype=torch.float64), 3
    blended = footprint_blur.blended(planes, torch.full((1, 7, 9), float(level)), BORDERS[border])
    expected = footprint_blur.boxed(planes, footprint.width(level), BORDERS[border])
    torch.testing.assert_close(blended, expected, atol=1e-12, rtol=0)


def test_a_map_is_near_the_box_of_every_pixel_itself(plane):
    texture = plane(0.0, 24, 30, (1, 1))[1][0]
    widths = 5 * torch.rand(24, 30, dtype=torch.float64)
    places = footprint.place(widths.square())[None]
    blended = footprint_blur.blended(texture[None, None], places, BORDERS["edge"])[0, 0]
    error = blended - slow_box(texture, widths, "edge")
    assert float(error.square().mean().sqrt()) < 0.004 * float(texture.std())
    assert float(error.abs().max()) < 0.03 * float(texture.std())


def test_the_width_of_a_pixel_does_not_change_others():
    image, widths = torch.rand(1, 1, 9, 9, dtype=torch.float64), torch.zeros(1, 9, 9)
    widths[0, 4, 4] = 3
    blended = footprint_blur.blended(image, footprint.place(widths.square()), BORDERS["edge"])
    changed = (blended - image).abs() > 1e-12
    assert changed.nonzero()[:, 2:].tolist() == [[4, 4]]


def test_uncovered_pixels_and_those_alone_have_no_inverse():
    coverage = torch.tensor([0.0, 0.5, 0.5, 1e-9], dtype=torch.float64)
    blurred = torch.tensor([0.2, 0.25, 0.01, -0.1], dtype=torch.float64)
    assert footprint_blur.inverse(coverage, blurred).tolist() == [0, 4, 0, 0]


def test_derivatives_in_both_modes():
    images = torch.rand(1, 1, 4, 5, dtype=torch.float64, requires_grad=True)
    places = (2.8 * torch.rand(1, 4, 5, dtype=torch.float64) + 0.1).requires_grad_()
    for border in BORDERS.values():
        assert torch.autograd.gradcheck(
            lambda x, p, border=border: footprint_blur.blended(x, p, border), (images, places), check_forward_ad=True
        )
