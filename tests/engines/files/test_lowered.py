"""Convolutions of half precision between tensors of float32."""

import pytest
import torch
from torch import nn

from lfref.engines.files.manifest import DTYPES, lowered


@pytest.mark.parametrize("precision", DTYPES)
def test_convolutions_are_halved_and_what_is_between_is_not(precision):
    module = nn.Sequential(nn.Conv2d(3, 8, 3), nn.InstanceNorm2d(8, affine=True), nn.Conv2d(8, 2, 1)).eval()
    made, images = lowered(module, precision), torch.rand(1, 3, 12, 12)
    types = [weight.dtype for weight in made.parameters()]
    assert types == [DTYPES[precision]] * 2 + [torch.float32] * 2 + [DTYPES[precision]] * 2
    with torch.no_grad():
        stack, exact = made(images), module(images)
    assert stack.dtype == torch.float32
    assert 1e-5 < float((stack - exact).abs().max()) < 0.03
    assert module[0].weight.dtype == torch.float32, "it is left as it is"


def test_who_asks_for_the_weights_gets_the_type_that_is_read():
    made = lowered(nn.Conv2d(2, 2, 1), "fp16")
    assert made.weight.dtype == torch.float32
    assert made.convolution.weight.dtype == torch.float16
