"""Pictures that are sharp everywhere, of a stack (`all_in_focus`) and of views (`extended_focus`).

`all_in_focus` takes the sharpest plane at each pixel of a refocused stack, and says where in the stack the peak lies.
Sharpness `E_n(y, x)` is the squared Laplacian of plane n, summed over channels and averaged over a Gaussian window
with a faint wide skirt. Far from focus, few views leave copies of an edge instead of a blur, as sharp as the edge but
as faint as one view; the skirt lets the edge itself win where nothing else is textured.
Stacks should come from interpolation that blurs no plane more than another (`exact_fourier`, or sums by `spline`):
linear interpolation pulls the index towards slopes whose shifts are whole. Limits: within about two radii of a depth
edge the stronger texture takes the weaker one's place, with high confidence; at borders, where views end or wrap round,
planes out of focus look sharp, so sharpness there is that of pixels just within (colours are the planes' own).

`extended_focus` takes at each pixel the mean of the views that show the same point. Views are read at the disparity of
each pixel, `L[v, u](x + d u, y + d v)`, and weighed by how well they agree with their robust mean
(`cost_volume.robust_mean`): views from which a nearer surface hides the point do not count, so that edges stay clean
and there are as few copies at borders as within. The others average their noise out, which is what the picture has over
the central view. Weights are computed once, in grey, and serve all channels.
Letters: `n` plane, `y x` pixel row and column, `F` noise floor, `k` view, `K` views that are read, `v u` their row and
column from the angular centre, `p q` position in a view along y and x, `d` disparity in pixels per view step.
Source: Nayar, Nakagawa, "Shape from Focus", 1994; its Gaussian peak is the parabola through log E.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.errors import InputError
from lfref.functional import loops, neighbours, splines
from lfref.functional.loops import compiled
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.disparity import cost_volume
from lfref.refocus.disparity.cost_volume import GreyViews, Integers, Reals, mean_of, read_spline, robust_mean
from lfref.refocus.disparity.disparity_map import disparity_map

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
    if stack.ndim < 4 or not stack.is_floating_point() or not radius >= 0:
        expected = "a stack must be floating point, [..., N, C, H, W], and the radius at least 0"
        raise InputError(expected, got=f"{stack.dtype}, {list(stack.shape)} and {radius}")
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
    """
    planes = geometry.as_slopes(slopes)
    steps = planes.diff()
    if len(planes) == 1:
        return planes.to(index).expand_as(index)
    inside = index.clamp(0, len(steps))
    below = inside.detach().long().clamp(max=len(steps) - 1)
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


@torch.no_grad()
def extended_focus(
    views: Tensor,
    disparity: Tensor | None = None,
    weights: Tensor | None = None,
    positions: Tensor | None = None,
) -> Tensor:
    """Make the picture of the central view with the light of all of them, on the CPU.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W], more than one view.
        disparity: Of each pixel of the central view, in pixels per view step, [..., H, W]; None estimates it.
        weights: Weight of each view, those of 0 are not read, [V, U]; None reads all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        Sharp pictures in the type (float32 for integers) and on the device of the views, [..., C, H, W]. No gradients.

    Raises:
        InputError: Views, a map, weights or positions that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> lfref.extended_focus(views).shape
        torch.Size([3, 48, 64])
    """
    batch = batches.flattened(views)
    grid, size = batches.grid_and_size(batch)
    aperture = batches.checked_weights(weights, grid)
    maps = disparity_map(views, weights=weights, positions=positions).disparity if disparity is None else disparity
    shape = (*views.shape[:-5], *size)
    if tuple(maps.shape) != shape:
        raise InputError(f"disparity must be {list(shape)}, a number a pixel", got=f"shape {list(maps.shape)}")
    if not bool(maps.isfinite().all()):
        raise InputError("disparity must be finite", got="NaN or infinity", remedy="fill what is missing first")
    maps = maps.detach().float().cpu().reshape(-1, *size)
    pictures = [_picture(field, aperture, positions, map_) for field, map_ in zip(batch, maps, strict=True)]
    return torch.stack(pictures).reshape(*shape[:-2], *views.shape[-3:]).to(views.device, batches.stack_dtype(views))


def _picture(views: Tensor, aperture: Tensor, positions: Tensor | None, disparity: Tensor) -> Tensor:
    """One light field [V, U, C, H, W] as one picture [C, H, W]."""
    grey = cost_volume.grey_of(views, aperture)
    weights, places = _weighed(cost_volume.grey_views(grey, aperture, positions), disparity)
    d, is_read = disparity.numpy(), (aperture > 0).to(views.device)
    n_threads = loops.worthwhile(disparity.numel(), 1 << 10)  # pixels from which one more thread pays
    channels = []
    for channel in views.detach().split(1, 2):  # one at a time: each needs a copy
        light = channel[:, :, 0][is_read]  # a copy of the views that are read
        samples = splines.coefficients(batches.radiance(light).float().cpu().numpy(), in_place=True)
        picture = np.empty_like(d)
        bands = loops.bands(len(disparity), n_threads)
        jobs = [(samples, places, d, weights[a:b], a, picture[a:b]) for a, b in bands]
        loops.share(add_views, jobs, n_threads)
        channels.append(torch.from_numpy(picture))
        del light, samples, jobs  # or the next channel's would be added to them
    return torch.stack(channels)


def _weighed(light: GreyViews, disparity: Tensor) -> tuple[Reals, Reals]:
    """Weights of the views at each pixel, [H, W, K], and their positions, [K, 2]; samples become coefficients."""
    d = disparity.numpy()
    noise = cost_volume.noise(light, torch.linspace(float(disparity.min()), float(disparity.max()), 9))
    spread = cost_volume.spread(light, noise).numpy()
    coefficients = splines.coefficients(light.samples.numpy(), in_place=True)
    positions, middle = light.positions.float().numpy(), np.array(light.middle)
    weights = np.empty((*disparity.shape, len(light.samples)), np.float32)
    n_threads = loops.worthwhile(disparity.numel(), 1 << 10)

    def weigh(first: int, last: int) -> None:
        weigh_views(coefficients, positions, middle, d, spread, first, weights[first:last])

    loops.share(weigh, loops.bands(len(disparity), n_threads), n_threads)
    return weights, positions


@compiled
def weigh_views(
    coefficients: Reals, positions: Reals, middle: Integers, disparity: Reals, spread: Reals, top: int, weights: Reals
) -> None:  # pragma: no cover - compiled
    """Weights [R, W, K] of the views at the pixels of a band of rows that begins at row `top`, each in [0, 1]."""
    n_views, height, width = coefficients.shape
    values = np.empty(n_views, np.float32)
    for i in range(weights.shape[0]):
        y = top + i
        for x in range(width):
            for k in range(n_views):
                p, q = y + disparity[y, x] * positions[k, 0], x + disparity[y, x] * positions[k, 1]
                values[k] = np.nan  # no sample beyond the borders: weight 0
                if 0 <= p <= height - 1 and 0 <= q <= width - 1:
                    values[k] = read_spline(coefficients[k], p, q)[0]
            # Once from the mean of the central views, then from the robust mean: no view is special.
            reference = robust_mean(values, mean_of(values, middle), spread[y, x], weights[i, x])
            robust_mean(values, reference, spread[y, x], weights[i, x])


@compiled
def add_views(
    coefficients: Reals, positions: Reals, disparity: Reals, weights: Reals, top: int, picture: Reals
) -> None:  # pragma: no cover - compiled
    """Weighted mean [R, W] of one channel of the views in a band of rows; 0 where no view has a sample."""
    for i in range(picture.shape[0]):
        y = top + i
        for x in range(picture.shape[1]):
            total, sum_of_weights = np.float32(0), np.float32(0)
            for k in range(len(coefficients)):
                weight = weights[i, x, k]
                if weight > 0:  # which also keeps reads within the view
                    p, q = y + disparity[y, x] * positions[k, 0], x + disparity[y, x] * positions[k, 1]
                    total += weight * read_spline(coefficients[k], p, q)[0]
                    sum_of_weights += weight
            picture[i, x] = total / max(sum_of_weights, np.float32(1e-12))
