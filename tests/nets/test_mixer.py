"""The mixer starts as nothing, mixes candidates alike for all colours, and takes any size."""

import pytest
import torch
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.nets.mixer import LEAST_ERROR, STEP, Mixer


def trained(**options):
    """A mixer that does something."""
    torch.manual_seed(3)
    net = Mixer(**{"n_guides": 4, "n_candidates": 2, "width": 8, "n_blocks": 1, "shuffle": 2} | options)
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    return net.eval()


def drawn(size=(16, 18), n_planes=3):
    """Features, pictures and error scale."""
    return torch.rand(n_planes, 10, *size), torch.rand(n_planes, 3, *size), torch.ones(n_planes, 1, *size)


def test_it_starts_by_leaving_pictures_as_they_are():
    features, pictures, error_scale = drawn()
    assert torch.equal(Mixer(4, 2)(features, pictures, error_scale), pictures)


@pytest.mark.parametrize("size", [(16, 18), (15, 17), (1, 1), (2, 3)])
@pytest.mark.parametrize("shuffle", [2, 4])
def test_any_size_and_any_leading_axes_keep_their_shape(size, shuffle):
    inputs, net = [torch.stack([each, each.flip(0)]) for each in drawn(size)], trained(shuffle=shuffle)
    result = net(*inputs)
    assert result.shape == inputs[1].shape
    torch.testing.assert_close(result[1, 2], net(*(each[1, 2] for each in inputs)), atol=1e-6, rtol=1e-5)
    assert not torch.equal(result, inputs[1])


def test_the_better_picture_is_the_sum_of_shares_and_differences():
    features, pictures, error_scale = drawn()
    net = trained()
    shares = net.shares(features[:, 6:])
    assert shares.shape == (3, 2, 16, 18)
    expected = pictures + shares[:, :1] * features[:, :3] + shares[:, 1:] * features[:, 3:6]
    torch.testing.assert_close(net(features, pictures, error_scale), expected, atol=1e-6, rtol=1e-6)


def test_shares_are_in_units_of_the_step():
    net = trained()
    for parameter in net.head[1].parameters():
        torch.nn.init.zeros_(parameter)
    torch.nn.init.ones_(net.head[1].bias)
    assert torch.equal(net.shares(torch.rand(1, 4, 6, 6)), torch.full((1, 2, 6, 6), STEP))


def test_pictures_stay_where_the_error_scale_is_0():
    features, pictures, error_scale = drawn()
    error_scale[:, :, :, 9:] = 0
    result = trained()(features, pictures, error_scale)
    assert torch.equal(result[..., 9:], pictures[..., 9:])
    assert not torch.equal(result[..., :9], pictures[..., :9])


def test_corrections_fade_in_where_the_error_scale_is_next_to_nothing():
    features, pictures, error_scale = drawn()
    net, whole = trained(), torch.ones_like(error_scale)
    correction = net(features, pictures, whole) - pictures
    half = net(features, pictures, 0.5 * LEAST_ERROR * whole) - pictures
    torch.testing.assert_close(half, correction / 2, atol=1e-6, rtol=1e-5)


def test_derivatives_are_right():
    net = trained().double()
    features, pictures, error_scale = (each.double() for each in drawn((4, 4), 1))
    assert gradcheck(lambda *inputs: net(*inputs, error_scale), (features.requires_grad_(), pictures.requires_grad_()))


@pytest.mark.parametrize("options", [{"shuffle": 3}, {"kernel": 2}, {"width": 0}, {"n_blocks": -1}, {"n_guides": 0}])
def test_sizes_that_make_no_network_are_refused(options):
    with pytest.raises(InputError, match="sizes must be at least 1"):
        Mixer(**{"n_guides": 4, "n_candidates": 2} | options)


def test_features_of_another_number_are_refused():
    features, pictures, error_scale = drawn()
    with pytest.raises(InputError, match="reads 10 channels of features; got 9"):
        trained()(features[:, 1:], pictures, error_scale)
