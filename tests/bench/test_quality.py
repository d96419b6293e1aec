"""Measures plane by plane: the interior and the whole frame, each by hand."""

import pytest
import torch

from lfref.bench import quality
from lfref.bench.quality import Shown, colour_difference
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim


def shown(stack):
    return Shown(stack, stack)


def test_every_measure_of_every_plane_inside_and_of_the_whole_frame():
    reference = torch.rand(2, 3, 24, 30)
    stack = reference + torch.tensor([0.1, 0.01])[:, None, None, None]
    stack[..., 0, :] = 0.7  # outside of the interior
    found = quality.planes(shown(stack), shown(reference), margin=4)
    inner = (..., slice(4, -4), slice(4, -4))
    for area, (one, other) in {"": (stack[inner], reference[inner]), "whole_": (stack, reference)}.items():
        assert found[f"{area}psnr_db"] == pytest.approx(psnr(one, other).tolist())
        assert found[f"{area}ssim"] == pytest.approx(ssim(one, other).tolist())
        assert found[f"{area}delta_e"] == pytest.approx(colour_difference(one, other).mean((-2, -1)).tolist())
        assert found[f"{area}brightness"] == pytest.approx((one.mean((1, 2, 3)) / other.mean((1, 2, 3))).tolist())
    assert found["psnr_db"] == pytest.approx([20, 40], abs=1e-3)


def test_colours_are_compared_in_linear_light():
    encoded, linear = torch.rand(2, 3, 12, 12), torch.rand(2, 3, 12, 12)
    found = quality.planes(Shown(encoded, linear), Shown(encoded, linear / 2), margin=0)
    assert found["psnr_db"] == [100, 100]
    assert found["delta_e"] == pytest.approx(colour_difference(linear, linear / 2).mean((-2, -1)).tolist())


def test_no_border_leaves_the_whole_frame():
    stack, reference = shown(torch.rand(1, 3, 12, 16)), shown(torch.rand(1, 3, 12, 16))
    found = quality.planes(stack, reference, margin=0)
    assert all(found[name] == found[quality.WHOLE + name] for name in quality.MEASURES)


def test_a_border_as_wide_as_the_picture_is_refused():
    quality.check_margin(8, (24, 30))
    with pytest.raises(InputError, match="pictures of 23x30; set margin=0"):
        quality.check_margin(8, (23, 30))
