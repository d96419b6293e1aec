"""What stands in for samples that are not to be trusted: the weighted mean of the views, or what layers predict."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.refocuser import filling
from tests.refocus.conftest import shifted_views, texture


@settings(deadline=None, max_examples=30)
@given(level=st.floats(0.01, 100), share=st.floats(0, 1), seed=st.integers(0, 99))
def test_samples_of_little_weight_give_way_to_the_weighted_mean(level, share, seed):
    generator = torch.Generator().manual_seed(seed)
    views = torch.rand(2, 3, 2, 5, 6, dtype=torch.float64, generator=generator)
    weight = level * (0.5 + 0.5 * torch.rand(2, 3, 1, 5, 6, dtype=torch.float64, generator=generator))
    at = (..., 2, 3)
    weight[0, 1, 0, 2, 3] = share * 0.1 * float(weight[1:, ..., 2, 3].max().maximum(weight[0, 0, 0, 2, 3]))
    weight[0, 2, 0, 2, 3] = weight[0, 0, 0, 2, 3]
    mean = (views * weight)[at].sum((0, 1)) / weight[at].sum((0, 1))
    trust = weight[0, 1, 0, 2, 3] / (0.1 * weight[at].max())
    expected = torch.lerp(mean, views[0, 1][at], trust)
    torch.testing.assert_close(filling.filled(views, weight)[0, 1][at], expected, atol=1e-12, rtol=0)


def test_what_has_no_weight_may_be_anything():
    views, weight = torch.rand(3, 3, 1, 5, 6), torch.ones(3, 3, 1, 5, 6)
    weight[0, 1], weight[:, :, :, 2, 2] = 0, 0
    expected = filling.filled(views, weight)
    wild = torch.where(weight > 0, views, torch.nan)
    assert torch.equal(filling.filled(wild, weight), expected)
    assert not expected[..., 2, 2].any()


def test_views_go_on_level_where_none_is_trusted():
    is_trusted = torch.ones(2, 3, 3, 1, 13, 18, dtype=torch.bool)
    is_trusted[1, ..., :7, :9], is_trusted[1, 0, 2] = False, False
    level = torch.tensor([0.2, 0.7])[:, None, None].expand(2, 3, 3, 2, 13, 18)
    nowhere = ~is_trusted.any(1, keepdim=True).any(2, keepdim=True)
    made = filling.extended(torch.where(nowhere, 9.0, level), is_trusted)
    torch.testing.assert_close(made, level)


@pytest.mark.parametrize("disparity", [-1.3, 0.4])
@pytest.mark.parametrize("hole", [(0, 0), (2, 3), (4, 1)])
def test_a_missing_view_of_a_plane_is_predicted(disparity, hole):
    whole = shifted_views(texture(2, 48, 52), disparity, (5, 5))
    weights = torch.ones(5, 5, dtype=torch.float64)
    weights[hole] = 0
    made = filling.predicted(torch.where(weights[:, :, None, None, None] > 0, whole, 9.0), weights)
    inner = (..., slice(8, -8), slice(8, -8))
    assert torch.equal(made[weights > 0], whole[weights > 0])
    error = (made - whole)[hole][inner].square().mean()
    mean_of_others = (whole[weights > 0].mean(0) - whole[hole])[inner].square().mean()
    assert float(error) < 1e-3 * float(mean_of_others)
