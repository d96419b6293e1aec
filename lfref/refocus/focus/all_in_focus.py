"""The sharpest plane at each pixel of a refocused stack: an all-in-focus picture, and where in the stack the peak lies.

Sharpness `E_n(y, x)` is the squared Laplacian of plane n, summed over channels and averaged over a Gaussian window
with a faint wide skirt. Far from focus, few views leave copies of an edge instead of a blur, as sharp as the edge but
as faint as one view; the skirt lets the edge itself win where nothing else is textured.
Stacks should come from interpolation that blurs no plane more than another (`exact_fourier`, or `exact` shift-and-sum):
linear interpolation pulls the index towards slopes whose shifts are whole. Limits: within about two radii of a depth
edge the stronger texture takes the weaker one's place, with high confidence; at borders, where views end or wrap round,
planes out of focus look sharp, so sharpness there is that of pixels just within (colours are the planes' own).
Letters: `n` plane, `y x` pixel row and column, `F` noise floor.
Source: Nayar, Nakagawa, "Shape from Focus", 1994; its Gaussian peak is the parabola through log E.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.geometry import Slopes
from lfref.refocus import batches

SKIRT_SHARE = 0.05
"""Weight of the skirt in the window: less lets copies of edges through, more blurs depth edges."""
SKIRT_WIDTH = 6
"""Standard deviation of the skirt, in radii."""
ROUNDING = 20 / (12 * 255**2)
"""Squared Laplacian that rounding to 8 bits gives a channel: (16 + 4) times its variance, 1 / (12 * 255²)."""
RIM = 4
"""Pixels at the border in which views end: twice the reach of cubic interpolation."""


class AllInFocus(NamedTuple):
    """Result of `all_in_focus` at each pixel."""

    image: Tensor
    """Colour of the sharpest plane, in the type of the stack, [..., C, H, W]."""
    index: Tensor  # type: ignore[assignment]
    """Where in the stack the sharpness peaks, between planes too, [0, N - 1], [..., H, W]."""
    confidence: Tensor
    """How clearly it peaks there, [0, 1), [..., H, W]."""


def all_in_focus(stack: Tensor, radius: float = 2.0) -> AllInFocus:
    """Take each pixel from the plane in which it is sharpest.

    The index is the whole number of that plane, moved by up to 1/2 to the peak of the parabola through log(E + F) of
    the plane and its two neighbours (the first and the last plane have one only, and stay).
    The confidence is `(E - R) / (E + F)`: E the largest sharpness, R the largest one of planes that are not its
    neighbours (0 if there are none), F what rounding to 8 bits would give. It is 0 where all planes are flat.

    Args:
        stack: Refocused planes, floating point (half types are computed in float32), [..., N, C, H, W].
        radius: Standard deviation of the window, in pixels, >= 0; wider is steadier on weak texture and noise, and
            coarser at depth edges.

    Returns:
        Image, index and confidence; index and confidence are float32 (float64 for such stacks). Gradients reach the
        planes that were chosen, through the index also their neighbours.

    Raises:
        InputError: A stack or radius that cannot be used.

    Example:
        >>> stack = lfref.exact_fourier(torch.rand(5, 5, 3, 48, 64), [-1, -0.5, 0, 0.5, 1])
        >>> image, index, confidence = lfref.all_in_focus(stack)
        >>> image.shape, index.shape
        (torch.Size([3, 48, 64]), torch.Size([48, 64]))
    """
    if stack.ndim < 4 or 0 in stack.shape:
        raise InputError("a stack must be [..., N, C, H, W] with no axis empty", got=f"shape {list(stack.shape)}")
    if not stack.is_floating_point():
        raise InputError("a stack must be floating point", got=stack.dtype, remedy="scale integers to [0, 1]")
    if not (math.isfinite(radius) and radius >= 0):
        raise InputError("radius must be finite and at least 0, in pixels", got=radius)
    planes = stack.reshape(-1, *stack.shape[-4:])
    working, floor = batches.working_dtype(stack.dtype), ROUNDING * stack.shape[-3]
    # One plane at a time keeps the working set small.
    energy = torch.stack([_sharpness(plane.to(working), radius) for plane in planes.unbind(1)], dim=1)
    best, last = energy.argmax(1, keepdim=True), energy.shape[1] - 1
    image = planes.gather(1, best[:, :, None].expand(-1, -1, *planes.shape[2:3], -1, -1))
    # The parabola through log(E + F). Both falls are at least 0, so its peak is within 1/2 of the best plane; the
    # constant is a difference of logarithms that float32 cannot tell from 0, and keeps ties at 0.
    log_energy = (energy + floor).log()
    top, before, after = (log_energy.gather(1, (best + step).clamp(0, last)) for step in (0, -1, 1))
    fall_before, fall_after = top - before, top - after
    peak = (fall_before - fall_after) / (2 * (fall_before + fall_after) + 1e-6)
    index = best + torch.where((best > 0) & (best < last), peak, 0.0)
    # The lead over planes that are not neighbours.
    number = torch.arange(last + 1, device=energy.device)[:, None, None]
    rival = torch.where((number - best).abs() > 1, energy, 0.0).amax(1, keepdim=True)
    most = energy.gather(1, best)
    confidence = (most - rival) / (most + floor)
    batch, size = stack.shape[:-4], stack.shape[-2:]
    return AllInFocus(
        image.reshape(*batch, *stack.shape[-3:]), index.reshape(*batch, *size), confidence.reshape(*batch, *size)
    )


def index_to_slope(index: Tensor, slopes: Slopes) -> Tensor:
    """Slopes, which are disparities, at positions between the planes of a stack.

    Args:
        index: Positions in the stack, floating point, held within [0, N - 1], any shape.
        slopes: Of its planes, in pixels per view step, rising or falling throughout, [N].

    Returns:
        Slopes in pixels per view step, linear between the planes, in the type and shape of the index.

    Raises:
        InputError: The slopes are not finite, or neither rise nor fall throughout; an index of integers.
    """
    if not index.is_floating_point():
        raise InputError("index must be floating point", got=index.dtype)
    # A grid of one view shifts nothing: only the numbers are checked.
    planes = geometry.checked_slopes(slopes, (1, 1), (1, 1))
    steps = planes.diff()
    if not (bool((steps > 0).all()) or bool((steps < 0).all())):
        raise InputError("slopes must rise or fall throughout", got=planes.tolist(), remedy="sort the planes")
    if len(planes) == 1:
        return planes.to(index).expand_as(index)
    inside = index.clamp(0, len(steps))
    below = inside.detach().nan_to_num().long().clamp(max=len(steps) - 1)
    return planes.to(index)[below] + (inside - below) * steps.to(index)[below]


def _sharpness(plane: Tensor, radius: float) -> Tensor:
    """Squared Laplacian under the window, [B, C, H, W] -> [B, H, W]."""
    padded = F.pad(plane, (1, 1, 1, 1), mode="replicate")
    rows = padded[..., :-2, 1:-1] + padded[..., 2:, 1:-1]
    columns = padded[..., 1:-1, :-2] + padded[..., 1:-1, 2:]
    energy = (4 * plane - rows - columns).square().sum(1)
    if radius == 0:
        return energy
    # The rim is replaced by the mirrored picture within it; small pictures have less of a rim.
    down, across = (min(RIM, (length - 1) // 4) for length in energy.shape[-2:])
    inner = energy[:, down : energy.shape[-2] - down, across : energy.shape[-1] - across]
    energy = F.pad(inner[None], (across, across, down, down), mode="reflect")[0]
    core, skirt = (neighbours.smoothed(energy, sigma) for sigma in (radius, SKIRT_WIDTH * radius))
    return torch.lerp(core, skirt, SKIRT_SHARE)
