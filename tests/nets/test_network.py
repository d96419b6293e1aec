"""After the first batch no output channel is dead; without it some are."""

import copy
import functools
import threading

import pytest
import torch
from torch import nn

from lfref.nets import network as head
from lfref.nets.blocks import NORMALIZATIONS
from lfref.nets.refnet import RefNet

SEEDS = range(16)


def small(seed, **options):
    torch.manual_seed(seed)
    network = RefNet(grid=(3, 3), widths=(16, 16), stem_width=16, **options)
    views = torch.rand(2, 3, 3, 3, 12, 13)
    return network, views, torch.rand(16, 3)[None, :, :, None, None] * torch.rand(2, 16, 3, 12, 13)


def raw(network, views):
    """The last convolution before its ReLU, [B, N C, H, W]."""
    return network.head(network.features(views))


def dead(network, views):
    """Output channels that are black on every pixel, and so never learn."""
    return int((raw(network, views) <= 0).all(3).all(2).all(0).sum())


def kaiming(network):
    """The other usual initialisation."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight)


@pytest.mark.parametrize("initialize", [lambda network: None, kaiming], ids=["default", "kaiming"])
def test_no_channel_is_born_dead_on_any_of_16_seeds(initialize):
    before, after = [], []
    for seed in SEEDS:
        network, views, labels = small(seed)
        initialize(network)
        before.append(dead(network, views))
        network.prime(views, None, labels)
        after.append(dead(network, views))
    assert after == [0] * len(SEEDS)
    # Otherwise there were nothing to cure, and this test would prove nothing.
    assert sum(before) > 16


@pytest.mark.parametrize("normalization", list(NORMALIZATIONS))
def test_each_channel_starts_at_its_labels_mean_with_a_small_spread(normalization):
    network, views, labels = small(0, normalization=normalization)
    network.prime(views, None, labels)
    # As the first training step will see it.
    deviation, mean = torch.std_mean(raw(network.train(), views), dim=(0, 2, 3))
    torch.testing.assert_close(deviation, torch.full((48,), 0.1), atol=1e-5, rtol=0)
    torch.testing.assert_close(mean, labels.flatten(1, 2).mean((0, 2, 3)), atol=1e-5, rtol=0)


@pytest.mark.parametrize(("deviation", "is_scaled"), [(1.1e-3, True), (0.9e-3, False)])
def test_an_output_is_scaled_unless_its_deviation_is_below_a_thousandth(deviation, is_scaled):
    last, features = nn.Conv2d(1, 1, 1), torch.tensor([-1.0, 1.0]).repeat(1, 1, 50, 50)
    nn.init.constant_(last.weight, deviation)
    head.prime(last, features, torch.zeros(1, 1, 50, 100))
    assert last(features).std().item() == pytest.approx(0.1 if is_scaled else deviation, rel=1e-3)


def test_only_the_last_convolution_changes():
    network, views, labels = small(0)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    network.prime(views, None, labels)
    changed = {name for name, value in network.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {"head.weight", "head.bias"}


@pytest.mark.parametrize("training", [True, False])
def test_the_mode_of_the_network_and_its_gradients_stay_as_they_were(training):
    network, views, labels = small(0)
    network.train(training)
    network.prime(views, None, labels)
    assert network.training == training
    assert all(parameter.requires_grad and parameter.grad is None for parameter in network.parameters())


def test_a_channel_that_does_not_vary_gives_finite_weights():
    network, views, labels = small(0, normalization="none", stem_kernel=1)
    network.prime(torch.zeros_like(views), None, torch.zeros_like(labels))
    assert all(bool(parameter.isfinite().all()) for parameter in network.head.parameters())


def test_a_black_first_batch_does_not_blow_up_the_weights():
    network, views, labels = small(0)
    network.prime(torch.zeros_like(views), None, torch.zeros_like(labels))
    # Zero padding leaves some contrast at the border, even here.
    assert float(network(views).detach().max()) < 20


def test_parts_of_a_batch_in_several_processes_give_the_start_of_the_whole_batch():
    network, views, labels = small(0)
    whole = copy.deepcopy(network)
    whole.prime(views, None, labels)
    parts = [copy.deepcopy(network) for _ in range(2)]
    meeting, waiting = threading.Barrier(2), [None, None]

    def total(value, rank):
        waiting[rank] = value
        meeting.wait()
        added = waiting[0] + waiting[1]
        meeting.wait()
        return added

    def work(rank):
        part = slice(rank, rank + 1)
        parts[rank].prime(views[part], None, labels[part], functools.partial(total, rank=rank))

    threads = [threading.Thread(target=work, args=(rank,)) for rank in range(2)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    for part in parts:
        torch.testing.assert_close(part.head.weight, whole.head.weight, rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(part.head.bias, whole.head.bias, rtol=1e-5, atol=1e-6)
