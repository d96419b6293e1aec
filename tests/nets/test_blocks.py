"""Blocks under autocast and in any memory layout, stems of colours, gains by place, and padding."""

import pytest
import torch
from torch import nn

from lfref.nets import blocks
from lfref.nets.blocks import EPSILON, NORMALIZATIONS, ResBlock


@pytest.mark.parametrize("filters", [8, 6])
def test_under_autocast_what_passes_the_block_keeps_all_its_digits(filters):
    block = ResBlock(8, filters, "relu")
    nn.init.zeros_(block.body[-1].weight)
    nn.init.zeros_(block.body[-1].bias)
    features = 16 + torch.rand(2, 8, 4, 4)
    expected = block(features)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(block(features), expected)


def test_a_stem_of_colours_reads_each_by_itself_with_the_same_weights():
    stem, images = blocks.StemConv2d(24, 6, 3, colours=3, inner=4), torch.rand(2, 2, 3, 4, 5, 6)
    result = stem(images.flatten(1, 3)).unflatten(1, (2, 3))
    for colour in range(3):
        expected = nn.functional.conv2d(images[:, :, colour].flatten(1, 2), stem.weight, stem.bias, padding=1)
        torch.testing.assert_close(result[:, :, colour], expected)


@pytest.mark.parametrize("normalization", list(NORMALIZATIONS))
@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float32])
@pytest.mark.parametrize("level", [0.0, 0.9])
def test_a_constant_is_normalised_to_nothing_with_a_finite_gradient(normalization, dtype, level):
    norm = NORMALIZATIONS[normalization](8).to(dtype)
    features = torch.full((2, 8, 6, 7), level, dtype=dtype, requires_grad=True)
    output = norm(features)
    output.backward(torch.randn_like(output))
    if normalization != "none":
        assert output.abs().max() <= 1e-3
    assert features.grad.isfinite().all()
    assert features.grad.abs().max() < 5 / EPSILON**0.5


@pytest.mark.parametrize("normalization", list(NORMALIZATIONS))
@pytest.mark.parametrize("batch", [1, 2])
def test_gradients_do_not_depend_on_the_memory_layout(normalization, batch):
    block = ResBlock(6, 8, normalization=normalization)
    images, gradient = torch.rand(batch, 6, 9, 7), torch.rand(batch, 8, 9, 7)

    def gradients(layout):
        block.to(memory_format=layout)
        inputs = images.clone(memory_format=layout).requires_grad_()
        return torch.autograd.grad(block(inputs), [inputs, *block.parameters()], gradient.to(memory_format=layout))

    for one, other in zip(gradients(torch.contiguous_format), gradients(torch.channels_last), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("side", [1, 2, 3])
@pytest.mark.parametrize("size", [(8, 12), (5, 4)])
def test_edges_are_repeated_until_pixels_are_whole(side, size):
    images = torch.rand(2, 3, *size)
    result = blocks.padded(images, side)
    assert result.shape[-2:] == tuple(-(-length // side) * side for length in size)
    rows, columns = (torch.arange(result.shape[axis]).clamp(max=images.shape[axis] - 1) for axis in (-2, -1))
    assert torch.equal(result, images[..., rows[:, None], columns])
