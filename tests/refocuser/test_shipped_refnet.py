"""The RefNet that ships refocuses: beside the mean of the views, in sharpness, in colour, and on a real capture."""

import pytest
import torch
from torch.nn import functional as F

import lfref
from lfref.data.datamodules import SimulatedSource
from lfref.metrics.stack import Explained
from lfref.nets import checkpoint
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import SHIPPED
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

FROM_375 = slice(2, None)
"""Planes of alpha .375 and more."""
FROM_5 = slice(3, None)
"""Planes of alpha .5 and more."""
LAPLACIAN = torch.tensor([[0.0, 1.0, 0.0], [1.0, -4.0, 1.0], [0.0, 1.0, 0.0]])[None, None]


@pytest.fixture(scope="module")
def network():
    return lfref.load("refnet")


@pytest.fixture(scope="module")
def stacks(network):
    """Views, labels and the network's stacks of the scenes of `make demo`, at half their size."""
    source = SimulatedSource(4, 2026, RandomScenes(Camera(size=(120, 160))))
    views = torch.stack([source.light(index).views for index in range(4)])
    return views, shift_and_sum(views, network.planes.slopes), network(views)


def explained(network, views, labels, stack):
    metrics = {group: Explained(network.planes.values, group) for group in ("near", "wide")}
    return {group: float(metric(stack, labels, views.mean((-5, -4)))) for group, metric in metrics.items()}


def test_it_has_the_papers_planes_and_its_card(network):
    assert network.planes.alphas == tuple(step / 8 for step in range(1, 17))
    assert (network.grid, network.is_linear, network.name) == ((7, 7), True, "refnet")
    assert SHIPPED["refnet"].stat().st_size <= 5e6
    assert checkpoint.read(SHIPPED["refnet"])["notes"]["card"]["licence"] == "MIT"


def test_it_explains_most_of_refocusing(network, stacks):
    shares = explained(network, *stacks)
    assert shares["near"] > 0.98
    assert shares["wide"] > 0.95


def test_it_refocuses_a_real_capture(network, lytro):
    views = lfref.read(lytro, angular_size=[7, 7]).views
    labels = shift_and_sum(views, network.planes.slopes)
    shares = explained(network, views, labels, network(views))
    assert shares["near"] > 0.98
    assert shares["wide"] > 0.93


def test_each_plane_is_nearest_to_its_own_label(network, stacks):
    _, labels, output = stacks
    distances = (output[:, :, None] - labels[:, None]).square().mean((3, 4, 5))
    nearest = distances.argmin(2)[:, FROM_375]
    assert torch.equal(nearest, torch.arange(16)[FROM_375].expand_as(nearest))


def test_planes_are_as_sharp_as_their_labels(stacks):
    # At alpha .375 the fine errors of the network are as large as what the wide blur leaves.
    _, labels, output = stacks
    sharpness = [F.conv2d(each[:, FROM_5].flatten(0, 2)[:, None], LAPLACIAN).abs() for each in (labels, output)]
    expected, ours = (each.mean((1, 2, 3)).unflatten(0, (4, -1, 3)).mean(2) for each in sharpness)
    torch.testing.assert_close(ours, expected, atol=0, rtol=0.15)


def test_colours_stay(stacks):
    _, labels, output = stacks
    means = [each.mean((-2, -1))[:, FROM_375] for each in (labels, output)]
    assert ((means[1] - means[0]).abs() / means[0]).mean() < 0.003
