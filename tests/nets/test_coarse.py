"""Whole coarse pixels, the same whether pictures are filled up at their size or at any."""

import pytest
import torch

from lfref.nets import blocks


@pytest.mark.parametrize("side", [1, 2, 3, 4])
@pytest.mark.parametrize("size", [(8, 12), (7, 9), (5, 4)])
def test_edges_are_repeated_until_pixels_are_whole(side, size):
    images = torch.rand(2, 3, *size)
    made = blocks.whole(images, side)
    assert made.shape[-2:] == tuple(-(-length // side) * side for length in size)
    rows, columns = (torch.arange(made.shape[axis]).clamp(max=images.shape[axis] - 1) for axis in (-2, -1))
    assert torch.equal(made, images[..., rows[:, None], columns])


@pytest.mark.parametrize("size", [(8, 12), (7, 9), (5, 4)])
def test_what_is_followed_at_one_size_is_run_at_others(size):
    class Whole(torch.nn.Module):
        def forward(self, images):
            return blocks.whole(images, 3)

    free = {2: torch.export.Dim.DYNAMIC, 3: torch.export.Dim.DYNAMIC}
    program = torch.export.export(Whole(), (torch.rand(2, 3, 10, 11),), dynamic_shapes=(free,))
    images = torch.rand(2, 3, *size)
    # Its guards are of strides, which nothing depends on.
    assert torch.equal(program.module(check_guards=False)(images), blocks.whole(images, 3))
