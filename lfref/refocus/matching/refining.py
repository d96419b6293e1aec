"""The last hundredths of a disparity: each pixel a step towards where its views agree best, then one smooth map.

Views are read between their samples by splines, with the weights that `agreement` gives them. How well a pixel knows
its disparity follows from how much its views would change with it; those that know little take their neighbours'.
Letters: `d` disparity in pixels per view step.
Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981.
"""

import numpy as np
import torch
from torch import Tensor

from lfref.functional import splines, threads
from lfref.refocus.matching import agreement, relaxing, steps_loop
from lfref.refocus.matching.grey import GreyViews

ROUNDS = 2
FARTHEST = 0.1
"""Pixels per view step that one step may go."""
SMOOTH = 1e3
"""How well neighbours know each other, per square of pixels per view step: they differ by about 0.03."""
GAP = 0.15
"""Difference between neighbours, in pixels per view step, from which they are of different surfaces."""
CALIBRATION = 0.1
"""Of what views seem to know: their errors are alike, and not noise alone."""
WORTH_A_THREAD = 1 << 10
"""Pixels from which one more thread saves more than it costs."""


def refined(views: GreyViews, disparity: Tensor, noise: float, first: float, last: float) -> Tensor:
    """A disparity map with its fractions, float32, [H, W].

    Args:
        views: The views.
        disparity: In pixels per view step, right to about 0.1, [H, W].
        noise: Standard deviation of a view.
        first: Least disparity there may be.
        last: Largest disparity there may be.
    """
    coefficients, spread = splines.coefficients(views.samples), agreement.spread(views, noise).numpy()
    variance = noise**2 + agreement.LEAST_NOISE**2
    for _ in range(ROUNDS):
        information, steps = _steps(views, coefficients, disparity.float().numpy(), spread)
        target = disparity + steps.clamp(-FARTHEST, FARTHEST)
        ties = [SMOOTH * torch.exp(-3 * (_differences(disparity, axis) / GAP).square()) for axis in (1, 0)]
        disparity = relaxing.relaxed(target, CALIBRATION / variance * information, *ties).clamp(first, last)
    return disparity.float()


def _steps(
    views: GreyViews, coefficients: np.ndarray, disparity: np.ndarray, spread: np.ndarray
) -> tuple[Tensor, Tensor]:
    information, steps = np.empty_like(disparity), np.empty_like(disparity)
    height, n_threads = len(disparity), threads.worthwhile(disparity.size, WORTH_A_THREAD)

    def find(top: int, end: int) -> None:
        band = slice(top, end)
        steps_loop.find_steps(
            coefficients, views.places, views.middle, disparity, spread, top, information[band], steps[band]
        )

    threads.share(find, threads.bands(height, n_threads), n_threads)
    return torch.from_numpy(information), torch.from_numpy(steps)


def _differences(disparity: Tensor, axis: int) -> Tensor:
    """To the next pixel along an axis; of the last one to itself."""
    return disparity.roll(-1, axis) - disparity
