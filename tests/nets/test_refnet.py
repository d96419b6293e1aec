"""RefNet: the paper's size, any batch dimensions, and a configuration that builds the same network again."""

import json

import pytest
import torch
from torch import nn

from lfref.errors import InputError
from lfref.nets.refnet import RefNet

TINY = {"n_planes": 2, "grid": (3, 2), "channels": 1, "widths": (6, 4), "stem_width": 5}


@pytest.fixture
def paper():
    with torch.device("meta"):
        return RefNet()


def count(network):
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_default_has_the_stated_number_of_parameters(paper):
    of_gains = 48 * 3 * 3
    assert count(paper) == 12_500_768 + of_gains


def test_the_default_is_the_papers_architecture(paper):
    assert len([layer for layer in paper.trunk if type(layer).__name__ == "ResBlock"]) == 11
    stem = paper.trunk[0]
    assert (stem.in_channels, stem.out_channels) == (7 * 7 * 3, 192)
    assert isinstance(paper.trunk[1], nn.ReLU)
    assert (paper.trunk[-2].in_channels, paper.trunk[-2].out_channels) == (256, 48)
    assert isinstance(paper.trunk[-1], nn.ReLU)
    assert (paper.head.in_channels, paper.head.out_channels) == (48, 48)
    assert paper(torch.empty(4, 7, 7, 3, 192, 192, device="meta")).shape == (4, 16, 3, 192, 192)


def test_the_stack_is_never_negative_and_its_axes_are_plane_then_channel():
    network = RefNet(**TINY | {"n_planes": 3, "channels": 2})
    views = torch.rand(3, 2, 2, 6, 5)
    with torch.no_grad():
        network.head.weight.zero_()
        network.head.bias.copy_(torch.tensor([0.1, 0.2, 0.3, 0.4, -1.0, 0.6]))
    stack = network(views)
    expected = torch.tensor([[0.1, 0.2], [0.3, 0.4], [0.0, 0.6]])
    torch.testing.assert_close(stack, expected[:, :, None, None].expand(3, 2, 6, 5))


def test_input_channels_are_rows_then_columns_then_colours():
    network = RefNet(**TINY | {"channels": 3})
    views = torch.zeros(3, 2, 3, 4, 4)
    views[2, 1, 0] = 1
    index = (2 * 2 + 1) * 3
    flat = torch.zeros(1, 18, 4, 4)
    flat[0, index] = 1
    torch.testing.assert_close(network.features(views), network.trunk(flat))


@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 2)])
def test_any_batch_dimensions(batch):
    network = RefNet(**TINY).eval()
    views = torch.rand(*batch, 3, 2, 1, 6, 5)
    stack = network(views)
    assert stack.shape == (*batch, 2, 1, 6, 5)
    flat = views.reshape(-1, 3, 2, 1, 6, 5)
    one_by_one = torch.stack([network(each) for each in flat]).reshape(stack.shape)
    torch.testing.assert_close(stack, one_by_one, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    "options",
    [
        {"n_blocks": 5},
        {"activation": "gelu", "normalization": "group", "style": "sibling"},
        {"stem_kernel": 5, "head_kernel": 3, "normalization": "batch"},
        {"shuffle": 2, "kernel": 5, "dilation": 2},
        {"channels": 2, "shuffle": 2, "stem_width": 6, "stem_by_colour": True},
        {"n_blocks": 4, "dilation": [1, 2], "padding": "zeros", "initialization": "random"},
    ],
)
def test_config_rebuilds_the_same_network_through_plain_text(options):
    network = RefNet(**TINY | options).eval()
    twin = RefNet(**json.loads(json.dumps(network.config))).eval()
    assert twin.config == network.config
    twin.load_state_dict(network.state_dict())
    views = torch.rand(3, 2, network.config["channels"], 6, 5)
    assert torch.equal(twin(views), network(views))


def test_on_a_coarser_grid_every_pixel_is_its_own_channel_at_its_place():
    network = RefNet(**TINY, shuffle=2)
    with torch.no_grad():
        network.head.weight.zero_()
        network.head.bias.copy_(torch.arange(8) / 10)
    expected = torch.tensor([[[0.0, 0.1], [0.2, 0.3]], [[0.4, 0.5], [0.6, 0.7]]]).repeat(1, 3, 3)[:, None, :5, :6]
    torch.testing.assert_close(network(torch.rand(3, 2, 1, 5, 6)), expected)


def reach(**options):
    """How many pixels a pixel in the middle of the stack sees to the left, and to the right; nothing normalised."""
    network = RefNet(n_planes=1, grid=(1, 1), channels=1, stem_width=8, normalization="none", **options)
    nn.init.constant_(network.head.bias, 10.0)  # the last ReLU must not hide the gradients
    nn.init.constant_(network.trunk[-2].bias, 10.0)
    nn.init.constant_(network.trunk[0].bias, 10.0)
    views = torch.rand(1, 1, 1, 9, 129, requires_grad=True)
    network.double()(views.double())[..., 4, 64].sum().backward()
    visible = views.grad.abs().sum((0, 1, 2, 3)).nonzero()[:, 0] - 64
    return -int(visible.min()), int(visible.max())


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"widths": (4,) * 11}, (12, 12)),  # the paper's: 25 x 25 pixels
        ({"widths": (4,) * 3, "kernel": 5}, (7, 7)),
        ({"widths": (4,) * 3, "dilation": [1, 2, 4]}, (8, 8)),
        ({"widths": (4,) * 4, "dilation": [1, 3]}, (9, 9)),  # stretched: 1, 1, 3, 3
        # Pixel 64 is the first of a coarse one: it sees 4 coarse ones on either side, and those whole.
        ({"widths": (4,) * 3, "shuffle": 2}, (8, 9)),
        ({"widths": (4,) * 3, "shuffle": 4, "stem_kernel": 1}, (12, 15)),
    ],
)
def test_how_far_a_pixel_sees(options, expected):
    assert reach(**options) == expected


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("autocast", [False, True])
def test_eleven_blocks_have_a_gradient_of_finite_norm_on_flat_views(level, autocast):
    network = RefNet(n_planes=2, grid=(2, 2), widths=(32,) * 11, stem_width=32)
    with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
        network(torch.full((1, 2, 2, 3, 12, 12), level)).float().square().mean().backward()
    assert nn.utils.get_total_norm([parameter.grad for parameter in network.parameters()]).isfinite()


@pytest.mark.parametrize("shape", [(2, 3, 1, 6, 5), (3, 2, 3, 6, 5), (3, 2, 1, 6), (3, 2, 1, 0, 5)])
def test_views_that_do_not_fit_are_refused(shape):
    with pytest.raises(InputError):
        RefNet(**TINY)(torch.rand(shape))


@pytest.mark.parametrize(
    "options",
    [
        {"n_planes": 0},
        {"grid": (7, 7, 7)},
        {"stem_kernel": 2},
        {"dilation": [1, 0]},
        {"padding": "reflect"},
        {"widths": ()},
        {"activation": "magic"},
    ],
)
def test_options_that_no_network_can_be_built_from_are_refused(options):
    with pytest.raises(InputError):
        RefNet(**TINY | options)
