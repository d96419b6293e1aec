"""The linear start gives a new network its labels' best linear prediction; the random one leaves no channel dead."""

import pytest
import torch
from torch.nn import functional as F

from lfref.data.datamodules import SimulatedSource
from lfref.geometry import planes_at_alphas
from lfref.metrics.stack import Explained
from lfref.nets.refnet import INITIALIZATIONS, PADDINGS, RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes


def small(seed, **options):
    torch.manual_seed(seed)
    network = RefNet(grid=(3, 3), widths=(16, 16), stem_width=16, **{"initialization": "random"} | options)
    views = torch.rand(2, 3, 3, 3, 12, 13)
    return network, views, torch.rand(16, 3)[None, :, :, None, None] * torch.rand(2, 16, 3, 12, 13)


def test_at_the_random_start_each_channel_has_its_labels_mean_and_none_is_dead():
    n_dead = 0
    for seed in range(8):
        network, views, labels = small(seed)
        n_dead += int((network.head(network.features(views)) <= 0).all(3).all(2).all(0).sum())
        network.initialize(views, None, labels)
        deviation, mean = torch.std_mean(network.head(network.features(views)), dim=(0, 2, 3))
        torch.testing.assert_close(deviation, torch.full((48,), 0.1), atol=1e-5, rtol=0)
        torch.testing.assert_close(mean, labels.flatten(1, 2).mean((0, 2, 3)), atol=1e-5, rtol=0)
    assert n_dead > 8  # otherwise there were nothing to cure


def linear_labels(views, n_planes=3, rank=3):
    """Weighted means over the 3x3 neighbourhoods of all views, each colour alike: views -> labels [B, N, C, H, W].

    Labels of all planes lie in a space of `rank` dimensions.
    """
    random = torch.Generator().manual_seed(3)
    taps = torch.rand(n_planes, views.shape[1] * views.shape[2], 3, 3, generator=random)
    taps[rank:] = taps[:rank].mean(0)
    taps /= taps.sum((1, 2, 3), keepdim=True)
    images = F.pad(views.movedim(3, 1).flatten(0, 1).flatten(1, 2), [1] * 4, mode="replicate")
    return F.conv2d(images, taps).unflatten(0, (len(views), -1)).movedim(2, 1)


def decibels(stack, labels):
    return -10 * float((stack - labels).detach().square().mean().log10())


COARSE = {"shuffle": 2, "widths": (80,), "stem_width": 80}


def started(views, labels, dtype=torch.float32, **options):
    """A new network after the linear start on these crops."""
    small = {"widths": (24, 24), "stem_width": 24}
    shape = {"n_planes": labels.shape[1], "grid": views.shape[1:3], "channels": views.shape[3]}
    network = RefNet(**shape, **small | options).to(dtype)
    network.initialize(views.to(dtype), None, labels.to(dtype))
    return network


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"activation": "relu", "normalization": "group", "style": "sibling"},
        {"widths": (32, 18, 24)},  # convolutions on the skips
        COARSE,
        COARSE | {"stem_by_colour": True, "stem_width": 81},
        {"dilation": [1, 2], "kernel": 5, "stem_kernel": 5, "head_kernel": 3},
    ],
    ids=str,
)
@pytest.mark.parametrize("training", [True, False])
def test_labels_that_are_linear_in_neighbourhoods_are_those_of_the_untrained_network(options, training):
    views, others = torch.rand(6, 3, 3, 3, 24, 26), torch.rand(2, 3, 3, 3, 20, 23)
    labels = linear_labels(others)
    assert decibels(others.mean((1, 2))[:, None], labels) < 25
    stack = started(views, linear_labels(views), **options).train(training)(others)
    # At the frame's edge these labels repeat pixels.
    assert decibels(*(each[..., 2:-2, 2:-2] for each in (stack, labels))) > 60


def means_within_the_frame(views):
    """The labels of `linear_labels` as means over the pixels within the frame."""
    sums, coverage = (
        linear_labels(F.pad(each.flatten(1, 3), [1] * 4).unflatten(1, views.shape[1:4]))
        for each in (views, torch.ones_like(views))
    )
    return (sums / coverage)[..., 1:-1, 1:-1]


@pytest.mark.parametrize("options", [{}, COARSE, {"stem_kernel": 5, "stem_by_colour": True}], ids=str)
def test_gains_at_the_frames_edge_make_sums_the_means_within_the_frame(options):
    views, others = torch.rand(6, 3, 3, 3, 24, 26), torch.rand(2, 3, 3, 3, 20, 24)
    reached = {}
    for padding in PADDINGS:
        stack = started(views, means_within_the_frame(views), padding=padding, **options)(others)
        reached[padding] = decibels(stack, means_within_the_frame(others))
    assert reached["renormalize"] > 55
    assert reached["zeros"] < 25


def test_a_narrow_stem_carries_the_principal_directions_of_the_labels():
    views, others = torch.rand(6, 3, 3, 3, 24, 26), torch.rand(2, 3, 3, 3, 20, 23)
    # 6 of 12 filters carry 9 labels, which lie in a space of 6 dimensions, or of 9.
    reached = []
    for rank in (2, 3):
        network = started(views, linear_labels(views, rank=rank), stem_width=12)
        stacks = network(others), linear_labels(others, rank=rank)
        reached.append(decibels(*(stack[..., 1:-1, 1:-1] for stack in stacks)))
    assert reached[0] > 60
    assert 25 < reached[1] < reached[0] - 10


@pytest.fixture(scope="module")
def scenes():
    """Views [4, V, U, C, H, W] of simulated scenes, their stacks by shift-and-sum, and the planes."""
    planes = planes_at_alphas((0.5, 0.75, 1.0, 2.0))
    source = SimulatedSource(4, 0, RandomScenes(Camera((3, 3), (48, 48))))
    views = torch.stack([source.light(index).views for index in range(4)])
    return views, shift_and_sum(views, planes.slopes), planes


def test_an_untrained_network_is_better_than_the_mean_of_the_views_after_the_linear_start_only(scenes):
    views, labels, planes = scenes
    shares = {}
    for kind in INITIALIZATIONS:
        stack = started(views[:3], labels[:3], initialization=kind)(views[3:])
        shares[kind] = float(Explained(planes.values)(stack.detach(), labels[3:], views[3:].mean((1, 2))))
    assert shares["linear"] > 0.5
    assert shares["random"] < -10


def test_under_autocast_the_stream_of_features_stays_in_float32(scenes):
    views, labels, _ = scenes
    network = started(views[:3], labels[:3])
    with torch.autocast("cpu", torch.bfloat16):
        stack = network(views[3:])
    assert stack.dtype == torch.float32
    exact, halved = network(views[3:]), network.bfloat16()(views[3:].bfloat16()).float()
    assert decibels(stack, exact) > max(55, decibels(halved, exact) + 5)


CROPS = {
    "black": torch.zeros(2, 3, 3, 3, 12, 14),
    "constant": torch.full((2, 3, 3, 3, 12, 14), 0.5),
    "one level each": torch.tensor([0.2, 0.7])[:, None, None, None, None, None].expand(-1, 3, 3, 3, 12, 14),
    "copies": torch.rand(2, 1, 1, 3, 12, 14).expand(-1, 3, 3, -1, -1, -1),
    "one row of views": torch.rand(2, 1, 7, 3, 12, 14),
    "fewer pixels than unknowns": torch.rand(1, 7, 7, 3, 5, 4),
    "two pixels": torch.rand(1, 3, 3, 3, 1, 2),
}


@pytest.mark.parametrize(("dtype", "least"), [(torch.float32, 60), (torch.bfloat16, 35)], ids=str)
@pytest.mark.parametrize("name", CROPS)
def test_hard_crops_give_their_own_labels(name, dtype, least):
    views = CROPS[name]
    labels = views[:, 0, :1].expand(-1, 2, -1, -1, -1)
    network = started(views, labels, dtype)
    assert all(bool(value.isfinite().all()) for value in network.state_dict().values())
    assert decibels(network(views.to(dtype)).float(), labels) > least
