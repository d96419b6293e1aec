"""The machine's own limits for shift-and-sum: how fast it moves the bytes, and how fast it multiplies and adds.

No program that reads the field and writes the stack can be faster than the first; none of this arithmetic can be
faster than the second, the rate of a large matrix product, the best use of the arithmetic units there is.
"""

import functools
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.bench import timing

ROUNDS = 5
SIDE = 2048  # of the matrices: large enough for the full rate, a fraction of a second on a CPU


class Limits(NamedTuple):
    """Least times of one linear shift-and-sum, in seconds."""

    bytes_s: float
    """To read the field and write the stack once, as fast as a copy in memory."""
    arithmetic_s: float
    """For its multiply-adds, as fast as in a matrix product."""


@torch.no_grad()
def shift_and_sum_limits(views: Tensor, n_planes: int) -> Limits:
    """Measure the limits where the views are.

    Args:
        views: Light field in float32, [V, U, C, H, W].
        n_planes: Planes of the stack.
    """
    copied, matrix = torch.empty_like(views), torch.rand(SIDE, SIDE, device=views.device)
    product = torch.empty_like(matrix)
    copying = _fastest(functools.partial(copied.copy_, views), views.device)
    multiplying = _fastest(functools.partial(torch.mm, matrix, matrix, out=product), views.device)
    stack_bytes = n_planes * views[0, 0].numel() * views.element_size()
    share_of_copy = (views.nbytes + stack_bytes) / (2 * views.nbytes)
    return Limits(copying * share_of_copy, multiplying * multiply_adds(views, n_planes) / SIDE**3)


def multiply_adds(views: Tensor, n_planes: int) -> int:
    """Multiply-adds of a linear shift-and-sum: two for each sample across every view row, two for each row's sum.

    Args:
        views: Light field, [V, U, C, H, W].
        n_planes: Planes of the stack.
    """
    n_rows, n_columns = views.shape[:2]
    return n_planes * views[0, 0].numel() * 2 * (n_rows * n_columns + n_rows)


def _fastest(run: functools.partial[Tensor], device: torch.device) -> float:
    return min(timing.seconds(run, device) for _ in range(ROUNDS))
