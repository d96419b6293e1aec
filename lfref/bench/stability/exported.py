"""RefNet as exported files in float32, one component a format, each read by `load` and run by its own runtime.

What is right is what the same network makes in PyTorch in float64, called like the file: views that are not finite are
refused by both.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Tensor

from lfref.bench import machine
from lfref.bench.accuracy import Row
from lfref.bench.stability import catalogue, networks, trials
from lfref.bench.stability.trials import OURS, Component, Precision
from lfref.engines.engine import FP32
from lfref.engines.files.formats import FORMATS
from lfref.export import checked, graphs
from lfref.export.checked import Wanted
from lfref.geometry import even_planes
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import Refocuser

PLANES = even_planes(networks.N_PLANES)
ERROR = 1e-3
"""As of networks in float32, a share of the brightest pixel: files compute so whatever type their views have."""


def components() -> list[Component]:
    """A component for each format whose packages are installed."""
    return [_component(name) for name, found in FORMATS.items() if not found.lacking]


def missing() -> Iterator[Row]:
    """A row for each format that cannot be tried, with what is not installed."""
    for name, found in FORMATS.items():
        if found.lacking:
            yield trials.missing(_title(name), f"no {' and no '.join(found.lacking)} installed")


def _component(name: str) -> Component:
    formulations = {OURS: _read_back(_refocuser(torch.float32), name)}
    exact = _refocuser(torch.float64)
    return Component(_title(name), catalogue.NETWORK_VIEWS, formulations, exact, _allowed, has_gradient=False)


def _title(name: str) -> str:
    return f"exported network, {name}"


def _refocuser(dtype: torch.dtype) -> NetworkRefocuser:
    return NetworkRefocuser(networks.network().to(dtype).requires_grad_(False), PLANES)


def _read_back(refocuser: NetworkRefocuser, name: str) -> Refocuser:
    subject = graphs.exportable(refocuser, PLANES, catalogue.NETWORK_GRID)
    with tempfile.TemporaryDirectory() as folder:
        wanted = Wanted(Path(folder, "network"), name, FP32, str(machine.version("lfref")))
        return load(checked.drafted(Path(folder), wanted, refocuser, subject))


def _allowed(right: Tensor, precision: Precision, *views: Tensor) -> Tensor:
    """Float32 must be right; a half type rounds the result besides."""
    rounding = 0.0 if precision.dtype == torch.float32 else torch.finfo(precision.dtype).eps / 2
    return ERROR * right.abs().max() + rounding * right.abs()
