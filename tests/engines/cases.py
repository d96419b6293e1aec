"""Small networks with odd sizes, as workloads: a RefNet, which reads views, and a refiner."""

import torch

from lfref.engines.engine import EngineWorkload
from lfref.nets.refiner import Refiner
from lfref.nets.refnet import RefNet

SIZE, PATCH = (31, 45), (24, 32)


def refnet(device="cpu"):
    """RefNet of two blocks, its pictures near 0.5 and never dark: a ReLU would hide an engine's faults."""
    network = RefNet(n_planes=2, grid=(3, 3), widths=(16, 8), stem_width=16).eval().requires_grad_(False)
    patches = [(torch.rand(1, 3, 3, 3, *PATCH),) for _ in range(3)]
    network.initialize(patches[0][0], None, 0.3 + 0.4 * patches[0][0][:, 1, :2])
    return _workload(network, (torch.rand(1, 3, 3, 3, *SIZE),), patches, device)


def refiner(device="cpu"):
    """A refiner that does something to four planes."""
    network = Refiner(n_features=5, n_candidates=1, width=16, n_blocks=1).eval().requires_grad_(False)
    for layer in network.modules():
        if isinstance(layer, torch.nn.Conv2d):
            torch.nn.init.kaiming_normal_(layer.weight)
    drawn = [
        (torch.randn(4, 5, *size), torch.rand(4, 3, *size), 0.05 * torch.rand(4, 1, *size))
        for size in (SIZE, PATCH, PATCH, PATCH)
    ]
    return _workload(network, drawn[0], drawn[1:], device)


def _workload(network, example, patches, device):
    moved = tuple(each.to(device) for each in example)
    return EngineWorkload(network.to(device), moved, [tuple(each.to(device) for each in patch) for patch in patches])


WORKLOADS = {"refnet": refnet, "refiner": refiner}
