"""The parts that all engines share: an engine turns a network, in one precision, into a faster function.

Letters: `H W` pixel row and column, the last two axes of every input of a network.
"""

import contextlib
import importlib.util
import io
import logging
import math
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor, nn

from lfref.errors import InputError

Inputs = tuple[Tensor, ...]
NetworkFunction = Callable[..., Tensor]
"""Function that is called like the network, with inputs of the shapes and types for which it was prepared."""

FP32, FP16, BF16, INT8 = "fp32", "fp16", "bf16", "int8"
"""Precisions: fp32 applies to all numbers; the other precisions apply to convolutions and their inputs."""
SMALL = 32
"""Pixels along a side of the inputs with which a network is traced where size does not matter."""


@dataclass(frozen=True, eq=False)
class EngineWorkload:
    """A network and its inputs."""

    network: nn.Module
    """The network in evaluation mode, with weights in float32; it returns one tensor."""
    example: Inputs
    """Inputs of the shapes and types of later calls, on the device of the weights, each [..., H, W]."""
    patches: Sequence[Inputs] = ()
    """Smaller inputs, on which int8 is calibrated."""

    @cached_property
    def small(self) -> Inputs:
        """Inputs of few pixels, for tracing."""
        return self.patches[0] if self.patches else tuple(images[..., :SMALL, :SMALL] for images in self.example)

    @property
    def device(self) -> torch.device:
        """Device of the network."""
        return self.example[0].device


@dataclass(frozen=True)
class Preparation:
    """One precision of one engine."""

    prepare: Callable[[EngineWorkload], NetworkFunction]
    """Function that prepares the network without changing it; it is called without gradients."""
    packages: tuple[str, ...] = ()
    """Packages that it needs besides PyTorch."""
    devices: tuple[str, ...] = ("cpu", "cuda")
    """Types of devices that it runs on."""
    programs: tuple[str, ...] = ()
    """Programs; one of them must be on the path."""
    is_able: Callable[[], bool] | None = None
    """Whether the processor computes in this precision, asked once the packages are there; None: every one does."""

    def lacking(self, device: torch.device) -> InputError | None:
        """The error that says what is missing to run on a device of this machine; None if nothing is missing."""
        if device.type not in self.devices:
            return InputError(f"this engine runs on {' and '.join(self.devices)}", got=device.type)
        if absent := [name for name in self.packages if importlib.util.find_spec(name) is None]:
            remedy = "pip install 'lfref[export]'"
            return InputError("this engine needs a package", got=f"no {' and no '.join(absent)}", remedy=remedy)
        if self.programs and not any(map(shutil.which, self.programs)):
            return InputError("this engine needs a C++ compiler", got="none", remedy=f"install {self.programs[0]}")
        if self.is_able is not None and not self.is_able():
            expected = "this precision needs a processor that computes in it"
            return InputError(expected, got="another one", remedy="take fp32")
        return None


def float_convolutions(kernels: Mapping[str, Sequence[int]]) -> list[str]:
    """Names of the convolutions that stay in floating point under int8.

    The first convolution reads light, whose finest differences between views matter: with 8 bits, a small RefNet lost 7
    dB. Convolutions of 1x1 pixels read sums that nothing has normalised, and are the smaller part of the work. With all
    of these in floating point, int8 costs 0.001 dB.

    Args:
        kernels: Height and width of each convolution by its name, in the order in which the network has them.
    """
    return [name for place, (name, size) in enumerate(kernels.items()) if place == 0 or math.prod(size) == 1]


def arrays(inputs: Inputs) -> list[Any]:
    """The inputs as contiguous NumPy arrays."""
    return [tensor.contiguous().numpy() for tensor in inputs]


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress output, warnings and log lines of libraries that convert a network; errors are still raised."""
    level = logging.root.manager.disable
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        try:
            yield
        finally:
            logging.disable(level)
