"""Views read at any position on the CPU, at the machine's speed: what the compiled loop takes, and threads for it."""

import itertools
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import chosen
from lfref.functional import threads
from lfref.refocus import batches
from lfref.refocus.anywhere import gather_loop
from lfref.refocus.anywhere.gather_loop import Places, Rule

INTERPOLATIONS = {"nearest": gather_loop.NEAREST, "linear": gather_loop.LINEAR, "cubic": gather_loop.CUBIC}
BEYOND = {
    "renormalize": gather_loop.LEFT_OUT,
    "edge": gather_loop.REPLICATED,
    "zero": gather_loop.BLACK,
    "wrap": gather_loop.PERIODIC,
}
WORTH_A_THREAD = 1 << 16
"""Samples of a stack from which one more thread saves more than it costs."""


def means(
    views: Tensor, aperture: Tensor, tables: Sequence[tuple[Tensor, Tensor]], interpolation: str, border: str
) -> tuple[Tensor, Tensor]:
    """Means of the views that have a sample, plane by plane: what `sampling.mean_of_views` computes.

    Args:
        views: Light fields on the CPU, floating point, uint8 or uint16, any strides, [B, V, U, C, H, W].
        aperture: Weights that sum to 1, float64, [V, U].
        tables: Matrices [V, U, 3, 3] and slopes [H, W] of each plane, float64; as in `gather_loop.Places`.
        interpolation: A key of `INTERPOLATIONS`.
        border: A key of `BEYOND`.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W], and coverages, float64, [N, H, W].

    Raises:
        InputError: Another interpolation or border.
    """
    rule = Rule(
        chosen("interpolation at positions that vary over the picture", interpolation, INTERPOLATIONS),
        chosen("border", border, BEYOND),
        1 / batches.FULL_SCALE.get(views.dtype, 1),
    )
    fields = (views if views.dtype in batches.FULL_SCALE else batches.radiance(views)).detach().numpy()
    height, width = views.shape[-2:]
    offsets = [geometry.angular_offsets(n).numpy() for n in aperture.shape]
    places = [Places(*(each.contiguous().numpy() for each in table), *offsets) for table in tables]
    weights = aperture.contiguous().numpy()
    working = np.float64 if views.dtype == torch.float64 else np.float32
    stack = np.empty((len(fields), len(places), views.shape[3], height, width), working)
    coverage = np.empty((len(places), height, width))
    n_threads = threads.worthwhile(stack.size, WORTH_A_THREAD)

    def work(b: int, n: int, band: tuple[int, int]) -> None:
        # All light fields write the same coverage.
        gather_loop.mean(fields[b], weights, places[n], rule, stack[b, n], coverage[n], *band)

    jobs = itertools.product(range(len(fields)), range(len(places)), threads.bands(height, n_threads))
    threads.share(work, jobs, n_threads)
    return torch.from_numpy(stack), torch.from_numpy(coverage)
