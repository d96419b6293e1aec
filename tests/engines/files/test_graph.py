"""Graphs know their free axes, and weights have one name."""

import copy

import torch
from torch import nn

from lfref.engines.files import manifest
from tests.engines.files import cases


def test_free_axes_are_those_that_are_letters():
    assert cases.views().free == ({0: "B", 4: "H", 5: "W"},)
    assert cases.refiner().free == ({0: "N", 2: "H", 3: "W"},) * 3


def test_a_digest_is_of_names_shapes_and_values():
    module = nn.Sequential(nn.Conv2d(2, 3, 1), nn.ReLU())
    known = manifest.digest(module)
    assert manifest.digest(copy.deepcopy(module)) == known
    other = copy.deepcopy(module)
    with torch.no_grad():
        other[0].bias[0] += 1e-3
    assert manifest.digest(other) != known
    assert manifest.digest(nn.Sequential(nn.Identity(), module[0])) != known
    assert manifest.digest(copy.deepcopy(module).to(memory_format=torch.channels_last)) == known
