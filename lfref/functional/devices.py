"""Numbers that a device computes, and what the host may know of them.

A GPU works through a queue, and a file is written before it is run: to read a number, the host waits for the queue, or
reads the number of an example. So code that runs anywhere asks here.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.utils import _python_dispatch

Function = TypeVar("Function", bound=Callable[..., Any])
BEYOND = 3e38
"""Stands for infinity, which files may not hold."""


def on_host(function: Function) -> Function:
    """A decorator of functions of few numbers that the host knows: for a file, their results are constants."""

    @functools.wraps(function)
    def run(*arguments: Any, **options: Any) -> Any:
        if not torch.compiler.is_exporting():
            return function(*arguments, **options)
        with _python_dispatch._disable_current_modes():
            return function(*arguments, **options)

    return run  # type: ignore[return-value]


def on_device(tensor: Tensor, device: torch.device, dtype: torch.dtype | None = None) -> Tensor:
    """A small tensor of the host on a device, which keeps it: later copies would wait, and no CUDA graph takes them."""
    stays = tensor.device == device or tensor.device.type != "cpu" or torch.compiler.is_exporting()
    if stays or tensor.requires_grad:
        return tensor.to(device, dtype or tensor.dtype)
    numbers = tuple(tensor.flatten().tolist())
    return _kept(numbers, tuple(tensor.shape), dtype or tensor.dtype, device)


@functools.lru_cache(maxsize=512)
def _kept(numbers: tuple[float, ...], shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    with torch.inference_mode(False):  # later calls may need derivatives
        return torch.tensor(numbers, dtype=dtype).reshape(shape).to(device, non_blocking=True)


def is_known(*tensors: Tensor) -> bool:
    """Whether the host can read numbers at no cost: on the CPU, except for a file."""
    return not torch.compiler.is_exporting() and all(tensor.device.type == "cpu" for tensor in tensors)


def may_hold(condition: Tensor) -> bool:
    """The value of a condition; True where the host does not know it."""
    return not is_known(condition) or bool(condition)


def at_most(count: Tensor, most: int) -> int:
    """The value of a count; the most that it may be where the host does not know it."""
    return int(count) if is_known(count) else most


def length_within(count: Tensor, most: int) -> int:
    """A count as the length of an axis; on a GPU, for which the host would wait, the most that it may be."""
    return length_of(count) if torch.compiler.is_exporting() else at_most(count, most)


def number(value: float, like: Tensor) -> Tensor:
    """A number on a device, float64; a file computes a length for pictures of any size."""
    return torch.full((), value, dtype=torch.float64, device=like.device)


def length_of(count: Tensor) -> int:
    """A count as the length of an axis, at least 1: in a file, a length that its input decides."""
    length: int = count.long().item() if torch.compiler.is_exporting() else int(count)  # type: ignore[assignment]
    if torch.compiler.is_exporting():
        torch._check(length >= 1)
        torch._check(length < 2**31)
    return length
