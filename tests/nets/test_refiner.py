"""The refiner starts as nothing, treats planes alike, and takes any size."""

import pytest
import torch
from torch.autograd import gradcheck

from lfref.nets.refiner import Refiner


def trained(**options):
    """A refiner that does something."""
    torch.manual_seed(3)
    net = Refiner(**{"n_features": 7, "n_candidates": 2, "width": 8, "n_blocks": 2} | options)
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    return net.eval()


def scale(pictures, value=0.05):
    return torch.full_like(pictures[..., :1, :, :], value)


def test_it_starts_by_leaving_pictures_as_they_are():
    pictures = torch.rand(5, 3, 16, 18)
    assert torch.equal(Refiner(7, 2)(torch.rand(5, 7, 16, 18), pictures, scale(pictures)), pictures)


@pytest.mark.parametrize("size", [(16, 18), (15, 17), (1, 1), (2, 3)])
@pytest.mark.parametrize("shuffle", [1, 2, 3])
def test_any_size_and_any_leading_axes_keep_their_shape(size, shuffle):
    features, pictures = torch.rand(2, 5, 7, *size), torch.rand(2, 5, 3, *size)
    net = trained(shuffle=shuffle)
    result = net(features, pictures, scale(pictures))
    assert result.shape == pictures.shape
    torch.testing.assert_close(
        result[1, 2], net(features[1, 2], pictures[1, 2], scale(pictures[1, 2])), atol=1e-6, rtol=1e-5
    )
    assert not torch.equal(result, pictures)


def test_without_blocks_it_is_two_convolutions_written_out():
    net = trained(n_features=2, n_candidates=2, n_blocks=0, shuffle=1, width=3, channels=1)
    features, pictures = torch.rand(1, 2, 6, 7), torch.rand(1, 1, 6, 7)
    inner = torch.nn.functional.silu(net.stem(features))
    error_scale = torch.rand(1, 1, 6, 7)
    first, second, gate = net.head[1](inner).unbind(1)
    added = 0.2 * torch.nn.functional.hardsigmoid(gate) * (first * features[:, 0] + second * features[:, 1])
    expected = pictures + error_scale * added[:, None]
    torch.testing.assert_close(net(features, pictures, error_scale), expected)


def test_gradients():
    net = trained(width=4, n_blocks=1).double()
    inputs = [torch.rand(1, n, 5, 6, dtype=torch.float64, requires_grad=True) for n in (7, 3, 1)]
    assert gradcheck(net, inputs)
