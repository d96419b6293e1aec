"""Interpolation through eight samples: polynomials are kept, pictures as by matrices."""

import pytest
import torch

from lfref import geometry
from lfref.functional import interpolation
from lfref.simulator.effects import optics


@pytest.mark.parametrize("degree", range(8))
def test_polynomials_are_reproduced(degree):
    t = torch.arange(0, 1, 0.07, dtype=torch.float64)
    taps = torch.tensor(interpolation.TAPS, dtype=torch.float64)
    torch.testing.assert_close(interpolation.weights(t) @ taps**degree, t**degree, atol=1e-10, rtol=0)


def test_views_are_read_as_by_matrices_also_beyond_their_edge():
    views = torch.rand(2, 3, 3, 20, 33, dtype=torch.float64)
    rows = geometry.angular_offsets(20) * 1.02 + torch.rand(2, 3, 1, 1, dtype=torch.float64)
    columns = geometry.angular_offsets(33) - 30 * torch.rand(2, 3, 3, 1, dtype=torch.float64)
    expected = optics.resample(views, rows.expand(2, 3, 3, 20), columns)
    torch.testing.assert_close(interpolation.resample(views, rows, columns), expected, atol=1e-12, rtol=0)


def test_whole_positions_keep_samples():
    views = torch.rand(1, 1, 1, 9, 12)
    rows, columns = geometry.angular_offsets(9), geometry.angular_offsets(12)
    assert torch.equal(interpolation.resample(views, rows, columns), views)
    assert torch.equal(interpolation.resample(views, rows, columns + 2)[..., :-2], views[..., 2:])
