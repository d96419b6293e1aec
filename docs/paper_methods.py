"""The methods of `paper.md`: the paper's two, the best classical one, and networks that learned from each label source.

Letters: `N` planes, `C H W` channel, pixel row and column.
"""

import functools

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.geometry import planes_at_alphas
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocus.shift.shift_and_sum import shift_and_sum, shift_and_sum_through_cells
from lfref.refocuser.refocuser import OperatorRefocuser

ALPHAS = tuple(step / 8 for step in range(1, 17))
PLANES = planes_at_alphas(ALPHAS)
PARALLEL = planes_at_alphas(ALPHAS, "parallel")
SEEDS = (0, 1, 2)

BEST = "occlusion_aware"
LABELS = ("shift_and_sum", "fourier_slice")
CLASSICAL = {
    name: OperatorRefocuser(name, operator)
    for name, operator in {
        "shift_and_sum": shift_and_sum,
        "fourier_slice": functools.partial(fourier_slice, kernel="kaiser_bessel", width=4, padding=2),
        "fourier_slice_linear": functools.partial(fourier_slice, kernel="linear", padding=1),
        "shift_and_sum_through_cells": shift_and_sum_through_cells,
        BEST: occlusion_aware,
    }.items()
}
"""The settings of `conf/method`."""
NETWORKS = {
    "RefNet on shift_and_sum": "shift_and_sum",
    "RefNet on fourier_slice": "fourier_slice",
    "RefNet on truth": "rendered",
}
"""Method -> what its labels are, a file of `conf/label`."""
PARALLEL_NETWORK = "RefNet on shift_and_sum, parallel"

LAPLACIAN = torch.tensor([[0.0, 1.0, 0.0], [1.0, -4.0, 1.0], [0.0, 1.0, 0.0]])[None, None]


def sharpness(stack: Tensor) -> Tensor:
    """Mean size of the Laplacian of every plane, [N, C, H, W] -> [N]."""
    return F.conv2d(stack.flatten(0, 1)[:, None], LAPLACIAN).abs().mean((1, 2, 3)).unflatten(0, stack.shape[:2]).mean(1)
