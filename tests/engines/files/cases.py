"""Small graphs: one that reads views of any size, one that reads features, pictures and error scale."""

import functools
import tempfile
from pathlib import Path

import torch

from lfref.engines.files import file_formats
from lfref.engines.files.file_formats import FORMATS
from lfref.engines.files.manifest import Graph, Manifest
from tests.engines import cases


def views():
    workload = cases.refnet()
    axes = {"views": ("B", 3, 3, 3, "H", "W")}
    example = (torch.rand(2, 3, 3, 3, 24, 28),)
    return Graph(workload.network, axes, ("B", 2, 3, "H", "W"), example, workload.patches)


def refiner():
    workload = cases.refiner()
    axes = {"features": ("N", 5, "H", "W"), "pictures": ("N", 3, "H", "W"), "error_scale": ("N", 1, "H", "W")}
    example = tuple(each[:2, :, :24, :28].contiguous() for each in workload.example)
    return Graph(workload.network, axes, ("N", 3, "H", "W"), example, workload.patches)


GRAPHS = {"views": views, "refiner": refiner}


def manifest(graph, precision="fp32"):
    entries = {"sha256": "0" * 64, "version": "1.2.3", "planes": {"slopes": [-1.0, 0.5], "convention": None}}
    return Manifest("net", graph.inputs, graph.output, precision, **entries)


@functools.cache
def contents(format, precision="fp32", kind="views"):
    """The graph of a file and the bytes of its parts by suffix; written once, since conversions take seconds."""
    torch.manual_seed(0)
    graph = GRAPHS[kind]()
    with tempfile.TemporaryDirectory() as folder:
        file_formats.write(Path(folder, f"net{FORMATS[format].suffix}"), format, graph, manifest(graph, precision))
        return graph, {path.suffix: path.read_bytes() for path in Path(folder).iterdir()}


def written(folder, format, precision="fp32", kind="views"):
    """A file in a folder, and its graph."""
    graph, parts = contents(format, precision, kind)
    for suffix, content in parts.items():
        (folder / f"net{suffix}").write_bytes(content)
    return folder / f"net{FORMATS[format].suffix}", graph


def inputs(graph, n, size):
    """Inputs of other sizes than those of the trace."""
    lengths = {"B": n, "N": n, "H": size[0], "W": size[1]}
    return tuple(torch.rand([lengths.get(axis, axis) for axis in axes]) for axes in graph.inputs.values())
