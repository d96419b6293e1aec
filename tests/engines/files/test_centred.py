"""Normalisations of what is centred are the same; of what is flat they are as precise as a mean need not be."""

import pytest
import torch
from torch import nn

from lfref.engines.files.as_onnx import centred
from lfref.nets.blocks import NORMALIZATIONS


@pytest.mark.parametrize("name", NORMALIZATIONS)
def test_a_network_computes_the_same(name):
    module = nn.Sequential(nn.Conv2d(3, 32, 3), NORMALIZATIONS[name](32), nn.ReLU()).eval()
    images = torch.rand(2, 3, 17, 19)
    made = centred(module)
    torch.testing.assert_close(made(images), module(images), atol=1e-5, rtol=0)
    assert isinstance(module[1], type(NORMALIZATIONS[name](32))), "it is left as it is"


def test_a_mean_that_is_off_does_not_matter():
    class Careless(nn.InstanceNorm2d):
        def forward(self, images):
            mean = images.mean((2, 3), keepdim=True) * (1 + 1e-5)
            return (images - mean) / ((images - mean).square().mean((2, 3), keepdim=True) + self.eps).sqrt()

    images = torch.full((1, 4, 16, 16), 0.7)
    module = nn.Sequential(Careless(4, 1e-5))
    assert float(module(images).abs().max()) > 1e-3
    assert float(centred(module)(images).abs().max()) < 1e-6
