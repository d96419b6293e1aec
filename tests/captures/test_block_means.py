"""Means of blocks: as PyTorch's, with what is clipped told."""

import pytest
import torch
from torch.nn import functional as F

from lfref.captures.brightness import block_means

NOTHING = torch.full((3,), torch.inf)


@pytest.mark.parametrize(("factor", "size"), [(1, (5, 7)), (4, (17, 30)), (3, (9, 9)), (5, (5, 12))])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_blocks_are_averaged(factor, size, dtype):
    images = torch.rand(4, 3, *size, dtype=dtype)
    torch.testing.assert_close(block_means(images, factor, NOTHING), F.avg_pool2d(images, factor))


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_a_block_with_a_clipped_sample_is_not_known(dtype):
    images = torch.full((2, 3, 8, 12), 0.5, dtype=dtype)
    images[1, 2, 5, 6] = 0.9
    means = block_means(images, 4, torch.tensor([0.8, 0.8, 0.9]))
    expected = torch.full((2, 3, 2, 3), 0.5, dtype=dtype)
    expected[1, 2, 1, 1] = torch.nan
    assert torch.equal(means.isnan(), expected.isnan())
    assert torch.equal(means.nan_to_num(), expected.nan_to_num())


def test_views_that_do_not_lie_in_one_piece_are_read_as_they_are():
    images = torch.rand(2, 3, 16, 20).transpose(2, 3)
    torch.testing.assert_close(block_means(images, 4, NOTHING), F.avg_pool2d(images, 4))
