"""The linear start gives a new network its labels' best linear prediction; the random one leaves no channel dead."""

import copy
import functools
import threading

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from lfref.data.datamodules import SimulatedSource
from lfref.geometry import planes_at_alphas
from lfref.metrics.stack import Explained
from lfref.nets import initialization
from lfref.nets.blocks import NORMALIZATIONS
from lfref.nets.refnet import INITIALIZATIONS, PADDINGS, RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

SEEDS = range(16)


def small(seed, **options):
    torch.manual_seed(seed)
    network = RefNet(grid=(3, 3), widths=(16, 16), stem_width=16, **{"initialization": "random"} | options)
    views = torch.rand(2, 3, 3, 3, 12, 13)
    return network, views, torch.rand(16, 3)[None, :, :, None, None] * torch.rand(2, 16, 3, 12, 13)


def raw(network, views):
    """The last convolution before its ReLU, [B, N C, H, W]."""
    return network.head(network.features(views))


def dead(network, views):
    """Output channels that are black on every pixel, and so never learn."""
    return int((raw(network, views) <= 0).all(3).all(2).all(0).sum())


def test_no_channel_is_born_dead_on_any_of_16_seeds():
    before, after = [], []
    for seed in SEEDS:
        network, views, labels = small(seed)
        before.append(dead(network, views))
        network.initialize(views, None, labels)
        after.append(dead(network, views))
    assert after == [0] * len(SEEDS)
    # Otherwise there were nothing to cure, and this test would prove nothing.
    assert sum(before) > 16


@pytest.mark.parametrize("normalization", list(NORMALIZATIONS))
def test_each_channel_starts_at_its_labels_mean_with_a_small_spread(normalization):
    network, views, labels = small(0, normalization=normalization)
    network.initialize(views, None, labels)
    # As the first training step will see it.
    deviation, mean = torch.std_mean(raw(network.train(), views), dim=(0, 2, 3))
    torch.testing.assert_close(deviation, torch.full((48,), 0.1), atol=1e-5, rtol=0)
    torch.testing.assert_close(mean, labels.flatten(1, 2).mean((0, 2, 3)), atol=1e-5, rtol=0)


def in_two_processes(work):
    """Results of work(rank, total) in two threads, whose `total` adds up what both give it."""
    meeting, waiting, results = threading.Barrier(2), [None, None], [None, None]

    def total(value, rank):
        waiting[rank] = value
        meeting.wait()
        added = waiting[0] + waiting[1]
        meeting.wait()
        return added

    def run(rank):
        results[rank] = work(rank, functools.partial(total, rank=rank))

    threads = [threading.Thread(target=run, args=(rank,)) for rank in range(2)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    return results


@pytest.mark.parametrize("kind", INITIALIZATIONS)
def test_parts_of_a_batch_in_two_processes_give_the_start_of_the_whole_batch(kind):
    network, views, labels = small(0, initialization=kind)
    whole = copy.deepcopy(network)
    whole.initialize(views, None, labels)

    def work(rank, total):
        part, own = slice(rank, rank + 1), copy.deepcopy(network)
        own.initialize(views[part], None, labels[part], total)
        return own

    for part in in_two_processes(work):
        for name, value in part.state_dict().items():
            torch.testing.assert_close(value, whole.state_dict()[name], rtol=1e-4, atol=1e-5, msg=name)


def drawn_pairs(n_features=5, n_labels=3):
    """Features [6, F, 4, 7] of unequal spread and offset, and labels [6, K, 4, 7]."""
    spread = torch.tensor([0.1, 1.0, 10.0, 1.0, 3.0])[:, None, None]
    return spread * torch.randn(6, n_features, 4, 7) + spread, torch.rand(6, n_labels, 4, 7)


def least_squares(features, labels):
    """NumPy's weights and bias, of one system of equations over all pixels."""
    x, y = (each.movedim(1, -1).flatten(0, -2).double().numpy() for each in (features, labels))
    solution = np.linalg.lstsq(np.column_stack([x, np.ones(len(x))]), y, rcond=None)[0]
    return solution[:-1].T, solution[-1]


def test_ridge_regression_is_least_squares_in_parts_and_in_two_processes(monkeypatch):
    monkeypatch.setattr(initialization, "RIDGE", 1e-12)
    monkeypatch.setattr(initialization, "SAMPLES_AT_ONCE", 50)
    pairs = drawn_pairs()
    covariance = np.cov(pairs[0].movedim(1, 0).flatten(1).double().numpy(), bias=True)

    def work(rank, total):
        parts = [tuple(each[part] for each in pairs) for part in (slice(4 * rank, 4 * rank + 1), slice(rank + 1, 4, 2))]
        return initialization.ridge_regression([*parts, *([[each[5:] for each in pairs]] if rank else [])], total)

    first = [[each[:1] for each in pairs], [each[1:] for each in pairs]]
    for weights, bias, of_features in (initialization.ridge_regression(first), *in_two_processes(work)):
        for ours, theirs in zip((weights, bias), least_squares(*pairs), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(of_features, covariance, rtol=1e-9, atol=1e-12)


def test_a_larger_penalty_shrinks_the_weights_and_keeps_the_mean(monkeypatch):
    features, labels = drawn_pairs()
    sizes = []
    for ridge in (1e-3, 1.0, 1e6):
        monkeypatch.setattr(initialization, "RIDGE", ridge)
        weights, bias, _ = initialization.ridge_regression([(features, labels)])
        sizes.append(float(weights.norm()))
        mean = weights @ features.double().mean((0, 2, 3)) + bias
        torch.testing.assert_close(mean, labels.double().mean((0, 2, 3)))
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 1e-5


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
        *({"normalization": normalization} for normalization in NORMALIZATIONS),
        *({"activation": activation} for activation in ("relu", "leaky_relu", "gelu", "silu", "elu")),
        {"style": "sibling"},
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


@pytest.mark.parametrize(("dtype", "least"), [(torch.float32, 60), (torch.float16, 50), (torch.bfloat16, 35)], ids=str)
@pytest.mark.parametrize("name", CROPS)
def test_hard_crops_give_their_own_labels(name, dtype, least):
    views = CROPS[name]
    labels = views[:, 0, :1].expand(-1, 2, -1, -1, -1)
    network = started(views, labels, dtype)
    assert all(bool(value.isfinite().all()) for value in network.state_dict().values())
    assert decibels(network(views.to(dtype)).float(), labels) > least


def test_crops_that_say_nothing_about_their_labels_give_the_labels_mean():
    labels = torch.rand(2, 2, 3, 12, 14)
    stack = started(CROPS["constant"], labels, normalization="none")(CROPS["constant"])
    inner = labels[..., 4:-4, 4:-4].mean((0, 3, 4), keepdim=True)
    stack = stack[..., 1:-1, 1:-1].detach()  # gains at the frame's edge are fitted to a few pixels
    torch.testing.assert_close(stack, inner.expand_as(stack), atol=1e-4, rtol=0)
