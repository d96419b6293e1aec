"""What every engine is: it makes of a network a function that computes the same, in one precision.

Letters: `H W` pixel row and column, the last two axes of whatever a network reads.
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

import torch
from torch import Tensor, nn

from lfref.errors import InputError

Inputs = tuple[Tensor, ...]
Run = Callable[..., Tensor]
"""Called like the network, with inputs of the shapes and types that it was prepared for."""

FP32, FP16, BF16, INT8 = "fp32", "fp16", "bf16", "int8"
"""Precisions: of all numbers; the others, of the products and what they read."""
LEAST = 32
"""Pixels along a side that a network is followed with, where what it does doesn't depend on them."""


@dataclass(frozen=True, eq=False)
class Job:
    """A network, and what it is going to be given."""

    network: nn.Module
    """In evaluation mode, its weights in float32; it returns one tensor."""
    example: Inputs
    """Of the shapes and types that it will be called with, on the device of its weights, each [..., H, W]."""
    patches: Sequence[Inputs] = ()
    """The like with fewer pixels, by which whole numbers are scaled."""

    @cached_property
    def small(self) -> Inputs:
        """Inputs of as few pixels as will do."""
        return self.patches[0] if self.patches else tuple(each[..., :LEAST, :LEAST] for each in self.example)

    @property
    def device(self) -> torch.device:
        """Where it runs."""
        return self.example[0].device


Prepare = Callable[[Job], Run]


@dataclass(frozen=True)
class Way:
    """One precision of one engine."""

    prepare: Prepare
    """Called without gradients; it leaves the network as it is."""
    packages: tuple[str, ...] = ()
    """What must be installed beside PyTorch."""
    devices: tuple[str, ...] = ("cpu", "cuda")
    """Types of devices that it runs on."""
    programs: tuple[str, ...] = ()
    """One of these must be on the path, if there are any."""

    def lacking(self, device: torch.device) -> InputError | None:
        """What is missing for it to run here; None: nothing.

        Args:
            device: Where it should run.
        """
        missing = [name for name in self.packages if importlib.util.find_spec(name) is None]
        if device.type not in self.devices:
            return InputError(f"this engine runs on {' and '.join(self.devices)}", got=device.type)
        if missing:
            remedy = "pip install 'lfref[export]'"
            return InputError("this engine needs a package", got=f"no {' and no '.join(missing)}", remedy=remedy)
        if self.programs and not any(map(shutil.which, self.programs)):
            return InputError("this engine needs a C++ compiler", got="none", remedy=f"install {self.programs[0]}")
        return None


def left_in_float(kernels: Mapping[str, Sequence[int]]) -> list[str]:
    """Names of the convolutions that whole numbers do not serve.

    The first one reads light, whose finest differences between views matter: 8 bits of it cost a small RefNet 7 dB.
    Those of one pixel read sums that nothing has normalised, and are the smaller part of the work. Without them whole
    numbers cost .001 dB.

    Args:
        kernels: Height and width of each by its name, in the order in which a network has them.
    """
    return [name for place, (name, size) in enumerate(kernels.items()) if place == 0 or math.prod(size) == 1]


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Keep to themselves what other libraries tell of a network that they convert: errors are still raised."""
    level = logging.root.manager.disable
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        try:
            yield
        finally:
            logging.disable(level)


def in_bf16(run: Run) -> Run:
    """The same with convolutions and products in bfloat16, and pictures in the type of the first input.

    Args:
        run: PyTorch's own operations.
    """

    def lowered(*inputs: Tensor) -> Tensor:
        # Weights that are turned once and kept would be dangling where a graph is replayed.
        with torch.autocast(inputs[0].device.type, torch.bfloat16, cache_enabled=False):
            stack = run(*inputs)
        return stack.to(inputs[0].dtype)

    return lowered
