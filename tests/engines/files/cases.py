"""Small graphs: one that reads views of any size, one that reads features, pictures and error scale."""

import torch
from torch import nn

from lfref.engines.files.manifest import Graph, Manifest
from tests.engines import cases


class Stack(nn.Module):
    """RefNet given nothing but views."""

    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, views):
        return self.network(views)


def views():
    workload = cases.refnet()
    axes = {"views": ("B", 3, 3, 3, "H", "W")}
    return Graph(
        Stack(workload.network).eval(), axes, ("B", 2, 3, "H", "W"), (torch.rand(2, 3, 3, 3, 24, 28),), workload.patches
    )


def refiner():
    workload = cases.refiner()
    axes = {"features": ("N", 5, "H", "W"), "pictures": ("N", 3, "H", "W"), "error_scale": ("N", 1, "H", "W")}
    example = tuple(each[:2, :, :24, :28].contiguous() for each in workload.example)
    return Graph(workload.network, axes, ("N", 3, "H", "W"), example, workload.patches)


GRAPHS = {"views": views, "refiner": refiner}


def manifest(graph, precision="fp32"):
    told = {"sha256": "0" * 64, "version": "1.2.3", "planes": {"slopes": [-1.0, 0.5], "convention": None}}
    return Manifest("net", graph.inputs, graph.output, precision, **told)


def inputs(graph, n, size):
    """Other ones than it was followed with."""
    lengths = {"B": n, "N": n, "H": size[0], "W": size[1]}
    return tuple(torch.rand([lengths.get(axis, axis) for axis in axes]) for axes in graph.inputs.values())
