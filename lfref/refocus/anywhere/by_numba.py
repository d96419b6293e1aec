"""Views read at any position on the CPU, at the machine's speed: what the compiled loop takes, and threads for it."""

import itertools
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from lfref.functional import threads
from lfref.refocus import batches
from lfref.refocus.anywhere import gather_loop
from lfref.refocus.anywhere.gather_loop import Rule, Table
from lfref.refocus.anywhere.places import Places
from lfref.refocus.borders import Border
from lfref.refocus.interpolations import Interpolation

WORTH_A_THREAD = 1 << 16
"""Samples of a stack from which one more thread saves more than it costs."""


def means(
    views: Tensor, aperture: Tensor, planes: Sequence[Places], way: Interpolation, border: Border
) -> tuple[Tensor, Tensor]:
    """Means and coverages of all planes, on the CPU; as `mean_of_views`, but for names that the loop knows."""
    assert way.number is not None, "the loop does not know this interpolation"
    assert border.number is not None, "the loop does not know this border"
    rule = Rule(way.number, border.number, 1 / batches.FULL_SCALE.get(views.dtype, 1))
    fields = (views if views.dtype in batches.FULL_SCALE else batches.radiance(views)).detach().numpy()
    height, width = views.shape[-2:]
    tables = [_table(places, views) for places in planes]
    weights = aperture.contiguous().numpy()
    working = np.float64 if views.dtype == torch.float64 else np.float32
    stack = np.empty((len(fields), len(tables), views.shape[3], height, width), working)
    coverage = np.empty((len(tables), height, width))
    n_threads = threads.worthwhile(stack.size, WORTH_A_THREAD)

    def work(b: int, n: int, band: tuple[int, int]) -> None:
        # All light fields write the same coverage.
        gather_loop.mean(fields[b], weights, tables[n], rule, stack[b, n], coverage[n], *band)

    jobs = itertools.product(range(len(fields)), range(len(tables)), threads.bands(height, n_threads))
    threads.share(work, jobs, n_threads)
    return torch.from_numpy(stack), torch.from_numpy(coverage)


def _table(places: Places, views: Tensor) -> Table:
    grid, size = batches.grid_and_size(views)
    still = torch.eye(3, dtype=torch.float64).expand(*grid, 3, 3)
    matrices = still if places.matrices is None else places.matrices
    slopes = torch.zeros(size, dtype=torch.float64) if places.slopes is None else places.slopes
    offsets = places.offsets(grid).contiguous().numpy()
    return Table(matrices.contiguous().numpy(), slopes.contiguous().numpy(), offsets)
