"""Finished planes blurred by boxes that differ from pixel to pixel: the last step of every operator that has a map.

Letters: `d` disparity, `s` slope; the footprint's.
"""

from torch import Tensor

from lfref.refocus import backend
from lfref.refocus.borders import BORDERS, Border
from lfref.refocus.footprint import by_torch, levels
from lfref.refocus.footprint.footprint import Footprint


def blurred(stack: Tensor, widths: Tensor, border: Border, coverage: Tensor | None = None) -> Tensor:
    """Planes seen through the cells of the aperture.

    Args:
        stack: Planes as sums over points, float32 or float64, [B, N, C, H, W].
        widths: Of the boxes, with any sign, in pixels, where the stack is, [B or 1, N, H, W].
        border: How planes continue beyond their edges.
        coverage: Share of the aperture that has a sample, [N, H, W]; read where only samples count.

    Returns:
        [B, N, C, H, W], 0 where there is no coverage.
    """
    places = levels.place(widths.to(stack.dtype).square())
    covered = coverage.to(stack) if border.counts_only_samples and coverage is not None else None
    if backend.compiler_for(stack, places) == "numba":
        # Imported here: a compiler takes half a second to load, which a program that never refocuses need not spend.
        from lfref.refocus.footprint import by_numba

        return by_numba.blurred(stack, places, border, covered)
    return by_torch.blurred(stack, places, border, covered)


def periodic(stack: Tensor, cell: Footprint, slopes: Tensor) -> Tensor:
    """Planes that wrap around seen through cells whose blur varies; others have been through their response.

    Args:
        stack: [B, N, C, H, W].
        cell: What each view covers of the picture.
        slopes: Of the planes, float64, [N].
    """
    if cell.fill == 0 or not cell.varies(slopes):
        return stack
    return blurred(stack, cell.widths(slopes), BORDERS["wrap"])
