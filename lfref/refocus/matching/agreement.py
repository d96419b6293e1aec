"""How far views disagree at each slope: the share of them that show something else than the central view does.

Every view counts as one vote, softly: a difference far beyond noise is one whole disagreement however great it is. So
the views from which a nearer surface hides the point outvote nobody, wherever in the aperture they are, and a bright
edge weighs no more than weak texture.
Letters: `s` slope in pixels per view step, `N` slopes tried.
Source: Black, Rangarajan, "On the Unification of Line Processes, Outlier Rejection, and Robust Statistics", 1996
(Geman-McClure's function of the difference).
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import threads
from lfref.refocus import windows
from lfref.refocus.interpolations import INTERPOLATIONS
from lfref.refocus.matching import agreement_loop
from lfref.refocus.matching.agreement_loop import Shifts
from lfref.refocus.matching.grey import GreyViews

LEAST_NOISE = 1e-3
"""Standard deviation that even good views have: rounding to 8 bits gives as much."""
NOISY = 2.0
"""Squares of the noise that a difference may have before it counts as half a disagreement."""
STEEP = 0.05
"""Pixels by which slopes between those that are tried shift a view that matters."""
QUIET = 0.25
"""Share of pixels that show nothing but noise at their best slope: others are interpolated, hidden, or shine."""
SAMPLED = 8
"""Of so many rows one says how much noise there is; and every second slope."""
WORTH_A_THREAD = 1 << 12
"""Pixels at one slope from which one more thread saves more than it costs."""


def noise(views: GreyViews, slopes: Tensor) -> float:
    """Standard deviation of what distinguishes views that show the same.

    Args:
        views: The views.
        slopes: Slopes of which one is about right for each pixel, in pixels per view step, [N].
    """
    height = views.samples.shape[1]
    # Alike from above and from below: mirrored views have a mirrored map.
    to_border = np.minimum(np.arange(height), np.arange(height)[::-1])
    rows = np.flatnonzero(to_border % SAMPLED == min(SAMPLED // 2, to_border.max()))
    # A spread far above all differences makes shares of them squares.
    even = np.ones(views.samples.shape[1:], np.float32)
    least = disagreements(views, slopes[::2], even, rows).amin(0)
    n_views = len(views.samples)
    quiet = float(least.flatten().kthvalue(1 + int(QUIET * (least.numel() - 1))).values)
    return max(quiet * n_views / (n_views - 1), 0.0) ** 0.5


def spread(views: GreyViews, noise: float) -> Tensor:
    """Square of the difference that counts as half a disagreement, [H, W].

    Args:
        views: The views.
        noise: Standard deviation of one.
    """
    return NOISY * noise**2 + LEAST_NOISE**2 + STEEP**2 * steepness(views.central)


def steepness(image: Tensor) -> Tensor:
    """Square of the gradient, averaged a little, [H, W]."""
    gradients = [torch.gradient(image, dim=axis)[0] for axis in (0, 1) if image.shape[axis] > 1]
    squares = sum((gradient.square() for gradient in gradients), torch.zeros_like(image))
    return windows.smoothed(squares[None], 1.0)[0]


def disagreements(
    views: GreyViews, slopes: Tensor, spread: NDArray[np.float32], rows: NDArray[np.int64] | None = None
) -> Tensor:
    """The share of views that disagree, [N, R, W].

    Args:
        views: The views.
        slopes: In pixels per view step, [N].
        spread: Square of the difference that counts as half a disagreement, [H, W].
        rows: Rows to look at, [R]; None looks at all.
    """
    height, width = views.samples.shape[1:]
    chosen = np.arange(height) if rows is None else rows
    shares = np.empty((len(slopes), len(chosen), width), np.float32)
    shifts = [_shifts(views, slope) for slope in slopes.tolist()]
    n_threads = threads.worthwhile(len(chosen) * width, WORTH_A_THREAD)

    def disagree(n: int, band: tuple[int, int]) -> None:
        part = slice(*band)
        agreement_loop.disagree(views.samples, views.middle, shifts[n], spread, chosen[part], shares[n, part])

    jobs = [(n, band) for n in range(len(slopes)) for band in threads.bands(len(chosen), n_threads)]
    threads.share(disagree, jobs, n_threads)
    return torch.from_numpy(shares)


def _shifts(views: GreyViews, slope: float) -> Shifts:
    height, width = views.samples.shape[1:]
    return Shifts(*_along(slope * views.places[:, 0], height), *_along(slope * views.places[:, 1], width))


def _along(shifts: NDArray, length: int) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """First sample read, weights and span of each view along one axis."""
    taps = [INTERPOLATIONS["cubic"].taps(float(shift)) for shift in shifts]
    starts = np.array([view[0][0] for view in taps], np.int64)
    weights = np.array([[weight for _, weight in view] for view in taps], np.float32)
    # Shifts that are whole but for rounding serve what they would serve if they were.
    near = np.where(np.abs(shifts - np.round(shifts)) < 1e-5, np.round(shifts), shifts)
    begins, ends = np.ceil(-near).clip(0, length), np.floor(length - 1 - near).clip(-1, length - 1) + 1
    return starts, weights, np.stack([begins, ends], 1).astype(np.int64)
