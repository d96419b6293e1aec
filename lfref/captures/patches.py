"""Small textured patches of the central view, and the same patches as every view shows them.

What is to be known of a few numbers a view is known from a few thousand pixels: patches whose texture has two
directions, at one disparity each, spread over the picture.
Letters: `k` patch, `i` view, `c` channel, `y x` pixel row and column, `T` tap.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.captures import patch_loop
from lfref.functional import threads
from lfref.simulator.effects import resampling

SIDE = 16  # pixels of a patch
RING = 2  # pixels around it that are read with it, for gradients
SAMPLES = 1 << 22  # of all patches in all views and channels, about
FEWEST, MOST = 24, 100  # patches looked for
SPREAD = 0.05  # standard deviation of disparity in a patch that halves its worth
BEFORE = -resampling.TAPS[0]
REACH = max(BEFORE, resampling.TAPS[-1]) + RING + 1  # pixels beyond a patch that are read, and one to move
WORTH_A_THREAD = 1 << 16


class Patches(NamedTuple):
    """Where the patches lie in the central view, and how much nearer than the focus they are."""

    rows: Tensor
    """First pixel row of each, int64, [K]."""
    columns: Tensor
    """First pixel column, int64, [K]."""
    disparity: Tensor
    """In pixels per view step, float64, [K]."""

    @property
    def centres(self) -> Tensor:
        """Middles of the patches, (row, column) in pixels from the top left sample, float64, [K, 2]."""
        return torch.stack([self.rows, self.columns], -1) + (SIDE - 1) / 2


def chosen(grey: Tensor, disparity: Tensor, places: Tensor, n_channels: int) -> Patches:
    """Choose patches that tell most: one for each cell of the picture, the best of those that lie there.

    Args:
        grey: Central view, [H, W].
        disparity: Of its pixels, in pixels per view step, [H, W].
        places: Of the views that are to show them, (v, u) from the angular centre, [I, 2].
        n_channels: That will be read.
    """
    wanted = min(MOST, max(FEWEST, SAMPLES // (len(places) * n_channels * (SIDE + 2 * RING) ** 2)))
    worth, middle = _worth(grey, disparity)
    reach = middle.abs() * float(places.abs().max()) + REACH
    stride = SIDE // 2
    tops, lefts = (stride * torch.arange(n) for n in worth.shape)
    rows_left, columns_left = grey.shape[0] - SIDE - tops, grey.shape[1] - SIDE - lefts
    room = torch.minimum(torch.minimum(tops, rows_left)[:, None], torch.minimum(lefts, columns_left))
    worth = torch.where(room > reach, worth, 0.0)
    side = max(2, round(math.sqrt(worth.numel() / wanted)))
    best, index = F.max_pool2d(worth[None], side, ceil_mode=True, return_indices=True)
    index = index.flatten()[best.flatten() > 0]
    at_row, at_column = index // worth.shape[1], index % worth.shape[1]
    return Patches(tops[at_row], lefts[at_column], middle.flatten()[index].double())


def _worth(grey: Tensor, disparity: Tensor) -> tuple[Tensor, Tensor]:
    """How well patches every half a side tell where they lie, and their disparity."""
    stride = SIDE // 2
    y, x = torch.gradient(grey)
    moments = torch.stack([y * y, y * x, x * x, disparity, disparity.square()])
    yy, yx, xx, mean, square = F.avg_pool2d(moments[None], SIDE, stride)[0]
    least = (yy + xx) / 2 - ((yy - xx).square() / 4 + yx.square()).sqrt()
    # Stripes too tell something, if only across themselves.
    detail = least.clamp(min=0) + 0.02 * (yy + xx)
    return detail / (1 + (square - mean.square()).clamp(min=0) / SPREAD**2), mean


def read(views: Tensor, patches: Patches, displacements: Tensor, channels: Sequence[int] | None = None) -> Tensor:
    """Patches with a ring of `RING` pixels around them, as views show them.

    Args:
        views: Floating point, CPU, [I, C, H, W].
        patches: Which.
        displacements: How much lower and farther right each view is read, in pixels, float64, [K, I, 2].
        channels: Which are read; None: all.

    Returns:
        Samples between samples, float32, [K, I, C, SIDE + 2 RING, SIDE + 2 RING].
    """
    starts = torch.stack([patches.rows, patches.columns], -1)[:, None] - RING + displacements
    side = SIDE + 2 * RING
    last = torch.tensor(views.shape[-2:]) - side - len(resampling.TAPS) + BEFORE
    starts = torch.minimum(starts.clamp(min=BEFORE), last.to(starts))
    whole = starts.floor()
    weights = resampling.weights(starts - whole).float()
    rows, columns = (whole.long() - BEFORE).unbind(-1)
    wanted = torch.tensor(range(views.shape[1]) if channels is None else channels)
    made = torch.empty(len(rows), len(views), len(wanted), side, side)
    tables = (wanted, rows, columns, weights[:, :, 0], weights[:, :, 1], made)
    arrays = [table.contiguous().numpy() for table in tables]
    n_threads = threads.worthwhile(made.numel(), WORTH_A_THREAD)
    samples = views.detach().numpy()
    threads.share(
        lambda first, last: patch_loop.read(samples, *arrays, first, last),
        threads.bands(len(made), n_threads),
        n_threads,
    )
    return made
