"""Pictures bounded by the views: near their sum where views agree, as they are where nothing is known."""

import pytest
import torch
from torch.nn import functional as F

from lfref.refocus import batches
from lfref.refocus.bounds import bounded_by_views
from lfref.refocus.focus.slope_range import DisparityRange
from lfref.refocus.fourier.energies import Energies
from lfref.refocus.scene import Scene
from tests.refocus.conftest import texture

APERTURE = batches.checked_weights(None, (5, 5))


def wide(views, reach):
    """A scene whose light is spread over a range of disparities."""
    scene = Scene(views, APERTURE, None)
    scene.known = DisparityRange(-1.0, 0.0, 4.0, (0.0, 3.0), (0.0, 3.0))
    ends, shares = torch.tensor([[0.0, reach], [0.5, 0.5]], dtype=torch.float64)
    scene.energies = Energies(ends, shares, torch.zeros(()))
    return scene


def test_a_picture_of_confused_layers_stays_near_the_sum_where_views_agree():
    views = texture(1, 64, 72).expand(5, 5, 1, 64, 72).clone()  # all at disparity 0
    views[:, :, :, :24] += 0.1 * torch.randn(5, 5, 1, 24, 72)
    stack, planes = torch.rand(1, 1, 64, 72, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    mean, spread = views.mean((0, 1)), views.std((0, 1), correction=0)
    nearest = F.max_pool2d(spread[None], 3, 1, 1)[0]
    assert torch.equal(bounded_by_views(stack, wide(views, 2.4), planes, APERTURE), stack)
    for reach, share in ((3.0, 0.15), (6.0, 0.0875), (20.0, 0.025)):
        bounded = bounded_by_views(stack, wide(views, reach), planes, APERTURE)
        torch.testing.assert_close(bounded[0, :, 26:], mean[:, 26:], atol=1e-6, rtol=0)
        off = ((bounded[0] - mean).abs() / nearest)[:, 1:22]
        assert float(off.max()) == pytest.approx(share, rel=1e-3)
        shifted = bounded_by_views(stack, wide(views, reach), planes + 3, APERTURE)
        assert torch.equal(shifted[..., :5, :], stack[..., :5, :])  # views at the border see other pixels
        assert not torch.equal(shifted, stack)


def test_planes_beyond_the_range_and_views_that_move_little_are_not_bounded():
    views, stack = texture(1, 64, 72).expand(5, 5, 1, 64, 72), torch.rand(2, 1, 64, 72, dtype=torch.float64)
    scene, planes = wide(views, 3.0), torch.tensor([-1.2, 0.0], dtype=torch.float64)
    bounded = bounded_by_views(stack, scene, planes, APERTURE)
    assert torch.equal(bounded[0], stack[0])
    assert not torch.equal(bounded[1], stack[1])
    scene.known = None
    assert torch.equal(bounded_by_views(stack, scene, planes, APERTURE), stack)
