"""The RefNet that ships refocuses: beside the mean of the views, in sharpness, in colour, and on a real capture."""

import pytest
import torch

import lfref
from lfref.data.datamodules import SimulatedSource
from lfref.metrics.stack import Explained
from lfref.nets import checkpoint
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import SHIPPED
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes


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
