"""One map of many costs: labels that are cheap at their pixels and seldom change from pixel to pixel.

The energy of a whole map cannot be minimised, that of a line can: each pixel takes the label that is cheapest over the
lines that reach it from eight directions. A change by one label, as on a slant, costs little; a jump costs more, and
less where the picture has an edge.
Letters: `N` labels, `H W` height and width.
Source: Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", 2008.
"""

import numpy as np
import torch
from torch import Tensor

from lfref.functional import threads
from lfref.refocus.matching import paths_loop

CHANGE = 0.3
"""Price of a change by one label, in costs of one pixel that is wholly wrong."""
JUMP = 1.5
"""Price of a jump where the picture is even."""
EDGE = 1.5
"""Mean differences between neighbours at which a jump costs half as much."""
DIRECTIONS = (((0, 1), (0, -1), (1, 1), (-1, -1)), ((1, 0), (-1, 0), (1, -1), (-1, 1)))
"""Steps along y and x, in two parts that can be followed at the same time: their sum must not depend on threads."""


def along_paths(costs: Tensor, picture: Tensor) -> Tensor:
    """Costs that take the neighbours into account, all directions together, [N, H, W].

    Args:
        costs: Of each label at each pixel, in [0, 1], float32, CPU, [N, H, W].
        picture: Says where edges are, [H, W].
    """
    last = np.ascontiguousarray(costs.permute(1, 2, 0).numpy())
    totals = [np.zeros_like(last) for _ in DIRECTIONS]

    def follow(part: int) -> None:
        for down, right in DIRECTIONS[part]:
            paths_loop.add_paths(last, _jumps(picture, down, right), CHANGE, down, right, totals[part])

    threads.share(follow, [(part,) for part in range(len(DIRECTIONS))], torch.get_num_threads())
    return torch.from_numpy(sum(totals[1:], totals[0])).permute(2, 0, 1).contiguous()


def _jumps(picture: Tensor, down: int, right: int) -> np.ndarray:
    """Price of a jump from the pixel before, [H, W]; what has none before it is never asked."""
    differences = (picture - picture.roll((down, right), (0, 1))).abs()
    neighbours = [picture.diff(dim=axis).abs().flatten() for axis in (0, 1)]
    usual = torch.cat(neighbours).mean() if picture.numel() > 1 else picture.new_ones(())
    steepness = differences / (EDGE * usual.clamp(min=torch.finfo(usual.dtype).tiny))
    return (JUMP / (1 + steepness)).clamp(min=CHANGE).float().numpy()
