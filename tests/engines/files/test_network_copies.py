"""Copies in half precision, and copies whose normalisations centre their input."""

import pytest
import torch
from torch import nn

from lfref.engines.files.network_copies import HALF_TYPES, centred_norms, half_convolutions
from lfref.nets.blocks import NORMALIZATIONS


@pytest.mark.parametrize("precision", HALF_TYPES)
def test_convolutions_are_halved_and_what_is_between_is_not(precision):
    module = nn.Sequential(nn.Conv2d(3, 8, 3), nn.InstanceNorm2d(8, affine=True), nn.Conv2d(8, 2, 1)).eval()
    result, images = half_convolutions(module, precision), torch.rand(1, 3, 12, 12)
    types = [weight.dtype for weight in result.parameters()]
    assert types == [HALF_TYPES[precision]] * 2 + [torch.float32] * 2 + [HALF_TYPES[precision]] * 2
    with torch.no_grad():
        stack, exact = result(images), module(images)
    assert stack.dtype == torch.float32
    assert 1e-5 < float((stack - exact).abs().max()) < 0.03
    assert module[0].weight.dtype == torch.float32, "it is left as it is"


def test_who_asks_for_the_weights_gets_the_type_that_is_read():
    result = half_convolutions(nn.Conv2d(2, 2, 1), "fp16")
    assert result.weight.dtype == torch.float32
    assert result.convolution.weight.dtype == torch.float16


@pytest.mark.parametrize("name", NORMALIZATIONS)
def test_a_network_computes_the_same(name):
    module = nn.Sequential(nn.Conv2d(3, 32, 3), NORMALIZATIONS[name](32), nn.ReLU()).eval()
    images = torch.rand(2, 3, 17, 19)
    result = centred_norms(module)
    torch.testing.assert_close(result(images), module(images), atol=1e-5, rtol=0)
    assert isinstance(module[1], type(NORMALIZATIONS[name](32))), "it is left as it is"


def test_a_mean_that_is_off_does_not_matter():
    class Careless(nn.InstanceNorm2d):
        def forward(self, images):
            mean = images.mean((2, 3), keepdim=True) * (1 + 1e-5)
            return (images - mean) / ((images - mean).square().mean((2, 3), keepdim=True) + self.eps).sqrt()

    images = torch.full((1, 4, 16, 16), 0.7)
    module = nn.Sequential(Careless(4, 1e-5))
    assert float(module(images).abs().max()) > 1e-3
    assert float(centred_norms(module)(images).abs().max()) < 1e-6
