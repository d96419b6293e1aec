"""Separable Wiener refocusing with a prior for each block of pixels, near focus.

Where a scene has many disparities, most places have one or two. Filters for these tell aliases apart that filters for
all disparities cannot, and are short near focus, where the aliases show. The steps:

1. Cut the picture into blocks of 16 x 16 pixels, and count the disparities in and around each (`block_priors`).
2. For each block and each plane near its disparities, solve for the filters of the rows and columns of views
   (`axis_filters`), and take their taps: `SPAN` pixels around the shift of each view.
3. Filter the views of a block along x, add them up, filter the rows along y, and add these up.
`blockwise_wiener` chooses between these filters and those of the whole field.
Letters: `B` blocks, `M` items (a block in a plane), `N` planes, `C` channels, `V U` view rows and columns, `D`
disparities, `T` taps, `y x` row and column of a pixel.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.functional import loops, neighbours
from lfref.functional.devices import at_most, is_known, on_device
from lfref.functional.loops import LANES
from lfref.refocus import axis_filters, batches
from lfref.refocus.axis_filters import AxisSpectrum
from lfref.refocus.disparity import cost_volume
from lfref.refocus.fourier.energies import Energies
from lfref.refocus.scene import Scene
from lfref.refocus.separable_wiener import products, same_axes

SPECTRUM = AxisSpectrum(aliased=1.0, unexplained=0.003)
"""By trial on both versions of sim30: blocks tell aliases apart, and more power beyond half a cycle does no harm."""
BLOCK = LANES
"""Side of a block, in pixels: as many as a register holds."""
AROUND = 8
"""Pixels around a block whose disparities count too: filters read as far, and views see them through the block."""
STEP = 0.06
"""Distance of neighbouring disparities of a prior, in pixels per view step."""
BROAD = 0.05
"""Probability that the disparity of a pixel is wrong: spread evenly over those of the block."""
ELSEWHERE = 0.06
"""Probability that light is at a disparity of the field that the map does not show: behind glass, in reflections."""
SPAN = 16
"""Taps of a filter."""
PERIOD = 48
"""Twice as many pixels as a filter could reach."""
NEAR, FADE = 1.0, 0.3
"""Distance of a plane from the disparities of a block, in pixels per view step, from which views are filtered alike
everywhere, and the range before it over which the block's filters fade: blur hides aliases from about 1 on."""
REACH = (5.0, 7.0)
"""Distances in pixels between the first and the last pixel that a filter must read: from the first one on it fades out,
from the second one on it is not used."""
FLOOR = 0.05
"""Least power of a pixel, of the mean: what is smooth has hardly any disparity."""
MOST_DISPARITIES = 1024
"""Largest number of disparities that the priors of a field have: beyond it their distance grows."""
FILTERS_AT_ONCE, ITEMS_AT_ONCE, ITEMS_OF_GPU = 3584, 32, 4096
"""Blocks times views of an axis whose filters are solved for together, and items that PyTorch filters together, on the
CPU and elsewhere."""


class Priors(NamedTuple):
    """Probabilities of disparities in blocks."""

    disparities: Tensor
    """In pixels per view step, float64, [D]."""
    shares: Tensor
    """Of each block, together 1, float64, [B, D]."""
    ends: Tensor
    """Least and largest disparity in and around each block, float64, [2, B]."""


class Items(NamedTuple):
    """What the loop does: a block of pixels in a plane."""

    corners: Tensor
    """Row and column of the first pixel, int64, [M, 2]."""
    row_centres: Tensor
    """Pixels by which a view row is shifted, int64, [M, V]."""
    column_centres: Tensor
    """Likewise of the columns, [M, U]."""
    rows: Tensor
    """Taps, float32 or float64, [terms, M, V, T]."""
    columns: Tensor
    """Taps, [terms, M, U, T]."""


def refocus_by_blocks(
    scene: Scene, planes: Tensor, disparity: Tensor, prior: Energies, aperture: Tensor
) -> tuple[Tensor, Tensor]:
    """The light field of a scene refocused at planes [N] near its disparities [H, W] by the filters of blocks.

    `prior` holds the disparities of the whole field; the aperture [V, U], of sum 1, is symmetric about both axes.
    Returns the stack, [N, C, H, W], and how near each plane is to a block, 0 where the stack is black, [N, 1, H, W].
    """
    field, spectrum = scene.light, SPECTRUM._replace(noise=scene.noise)
    n_channels, (height, width) = field.shape[2], field.shape[-2:]
    planes = on_device(planes, field.device)
    priors = block_priors(disparity, _steepness(scene.central), prior, scene.widest)
    terms = products(aperture)
    counts = (height + BLOCK - 1) // BLOCK, (width + BLOCK - 1) // BLOCK
    low, high = priors.ends
    distance = torch.maximum(low - planes[:, None], planes[:, None] - high)
    # Pixels of the outermost view that filters of a block would have to read, beyond the tails of one surface.
    outermost = (max(field.shape[:2]) - 1) / 2
    reach = outermost * (high.maximum(planes[:, None]) - low.minimum(planes[:, None]))
    nearness = ((NEAR - distance) / FADE).minimum((REACH[1] - reach) / (REACH[1] - REACH[0])).clamp(0, 1)
    lengths = (field.shape[0], field.shape[1])
    # Square grids and symmetric apertures have the same filters along both axes.
    is_same = all(same_axes(term) for term in terms)
    axes = [(lengths[1], [term.columns for term in terms])]
    if not is_same:
        axes = [(lengths[0], [term.rows for term in terms]), *axes]
    tables = [
        [
            axis_filters.tables(spectrum, priors.disparities, planes, on_device(weights, field.device), PERIOD)
            for weights in of_axis
        ]
        for _, of_axis in axes
    ]
    # Where the host does not know which planes are near a block, all are filtered.
    is_countable = is_known(nearness)
    n_blocks = nearness.shape[1]
    every = torch.arange(n_blocks, device=field.device)
    some = (nearness > 0).any(0).nonzero()[:, 0] if is_countable else every
    pictures = field.new_zeros(len(planes), n_blocks, n_channels, BLOCK, BLOCK)
    for blocks in some.split(max(1, FILTERS_AT_ONCE // max(lengths)) if is_countable else n_blocks):
        # Block by block: its views stay in the processor's caches.
        if is_countable:
            b, n = (nearness[:, blocks] > 0).T.nonzero(as_tuple=True)
        else:
            item = torch.arange(n_blocks * len(planes), device=field.device)
            b, n = item // len(planes), item % len(planes)
        # Taps lie around the middle of all that is read: pixels in focus, and those at the disparities of the block.
        lowest, highest = low[blocks].minimum(planes[:, None]), high[blocks].maximum(planes[:, None])
        shifts = ((lowest + highest) / 2)[n, b, None]
        shares, centres, taps = priors.shares[blocks], [], []
        for (n_views, _), of_axis in zip(axes, tables, strict=True):
            centres.append((shifts * geometry.angular_offsets(n_views, shifts.device)).round().long())
            filters = [
                axis_filters.filters(spectrum, table, planes, shares, shares @ priors.disparities) for table in of_axis
            ]
            taps.append(torch.stack([_taps(each[b, n], centres[-1]) for each in filters]))
        if is_same:
            centres, taps = 2 * centres, 2 * taps
        index = blocks[b]
        corners = BLOCK * torch.stack([index // counts[1], index % counts[1]], 1)
        items = Items(corners, *centres, *(of_axis.to(field.dtype) for of_axis in taps))
        pictures[n, index] = filtered(field, items)
    grid = pictures.unflatten(1, counts).permute(0, 3, 1, 4, 2, 5)
    stack = grid.reshape(len(pictures), n_channels, BLOCK * counts[0], BLOCK * counts[1])[..., :height, :width]
    spread = nearness.to(field).unflatten(1, counts)[:, None]
    spread = spread.repeat_interleave(BLOCK, 2).repeat_interleave(BLOCK, 3)[..., :height, :width]
    return stack, spread


def _taps(filters: Tensor, centres: Tensor) -> Tensor:
    """Taps [M, I, SPAN] of filters [M, K, I] around centres [M, I]."""
    taps = axis_filters.kernels(filters, centres, SPAN)
    # What lies beyond the taps is missing: the mean brightness stays.
    levels = (filters[:, 0] * axis_filters.counts(filters.shape[-1], filters.device)).sum(-1)
    sums = taps.sum((1, 2))
    is_safe = (levels.abs() > 1e-6) & (sums.abs() > 0.5 * levels.abs())
    return taps * torch.where(is_safe, levels / torch.where(is_safe, sums, 1.0), 1.0)[:, None, None]


def block_priors(disparity: Tensor, power: Tensor, prior: Energies, widest: float) -> Priors:
    """Priors of the blocks of a disparity map [H, W], row by row: disparities in and around each, and the whole field's
    prior, for light that the map does not show. All disparities are at most `widest` apart."""
    disparity = disparity.detach().double()
    below, right = (-length % BLOCK + AROUND for length in disparity.shape)
    padded, padded_power = (
        F.pad(image[None, None], (AROUND, right, AROUND, below), mode="replicate")
        for image in (disparity, power.detach().double())
    )
    window = BLOCK + 2 * AROUND
    around = F.unfold(padded, window, stride=BLOCK)[0].T  # [B, pixels]
    low, high = around.amin(1), around.amax(1)
    first = torch.minimum(low.amin(0), prior.disparities[0])
    last = torch.maximum(high.amax(0), torch.where(prior.shares > 0, prior.disparities, first).amax(0))
    step = ((last - first) / MOST_DISPARITIES).clamp(min=STEP)
    most = min(math.ceil(widest / STEP), MOST_DISPARITIES) + 4
    n_disparities = at_most(((last - first) / step).ceil() + 4, most)
    disparities = first + step * (torch.arange(n_disparities, dtype=torch.float64, device=disparity.device) - 1)
    weights = F.unfold(padded_power, window, stride=BLOCK)[0].T
    counted = _counted(around, weights, disparities)
    # Maps are not exact: a disparity is likely beside those that were found, too.
    beside = F.pad(counted, (1, 1))
    counted = counted / 2 + (beside[:, :-2] + beside[:, 2:]) / 4
    is_within = (disparities > low[:, None] - 1.5 * step) & (disparities < high[:, None] + 1.5 * step)
    parts = (
        (1 - BROAD - ELSEWHERE, counted),
        (BROAD, is_within.double()),
        (ELSEWHERE, _counted(prior.disparities[None], prior.shares[None], disparities)),
    )
    shares = torch.stack([share * (part / part.sum(1, keepdim=True)).expand_as(counted) for share, part in parts]).sum(
        0
    )
    return Priors(disparities, shares, torch.stack([low, high]))


def _steepness(central: Tensor) -> Tensor:
    """Power of the detail of each pixel of the middle view [H, W], with a floor, [H, W]."""
    power = neighbours.box_mean(cost_volume.steepness(central)[None, None], 3)[0, 0]
    return power + FLOOR * power.mean() + torch.finfo(power.dtype).tiny


def _counted(values: Tensor, weights: Tensor, disparities: Tensor) -> Tensor:
    """Weights [B, P] of values [B, P], each shared by its two neighbours among even disparities [D], [B, D]."""
    places = (values - disparities[0]) / (disparities[1] - disparities[0])
    under = places.floor().long().clamp(0, len(disparities) - 2)
    counted = values.new_zeros(len(values), len(disparities))
    counted.scatter_add_(1, under, weights * (1 - places + under))
    return counted.scatter_add_(1, under + 1, weights * (places - under))


def filtered(field: Tensor, items: Items) -> Tensor:
    """The pixels of items: views [V, U, C, H, W] filtered along both axes and added up, [M, C, BLOCK, BLOCK].

    Beyond the border, the outermost pixels are repeated.
    """
    if not batches.is_compiled(field):
        return _by_torch(field, items)
    views = field.contiguous().numpy()
    n_items = len(items.corners)
    result = np.zeros((n_items, field.shape[2], BLOCK, BLOCK), views.dtype)
    if n_items == 0:
        return torch.from_numpy(result)
    arrays = [tensor.contiguous().numpy() for tensor in items]
    n_threads = loops.worthwhile(n_items, 8)
    jobs = ((views, *arrays, *band, result) for band in loops.bands(n_items, 4 * n_threads))
    loops.share(add_items, jobs, n_threads)
    return torch.from_numpy(result)


def _by_torch(field: Tensor, items: Items) -> Tensor:
    """As `filtered`, with derivatives, and on a GPU: products with Toeplitz matrices of the taps."""
    device, (height, width) = field.device, field.shape[-2:]
    length = BLOCK + SPAN - 1
    span, pixel = torch.arange(length, device=device) - SPAN // 2, torch.arange(BLOCK, device=device)
    tap = torch.arange(SPAN, device=device)
    toeplitz = (pixel + tap[:, None, None] == span[:, None] + SPAN // 2).to(field)  # [SPAN, length, BLOCK]
    v, u = (torch.arange(n_views, device=device) for n_views in field.shape[:2])
    parts = [field.new_zeros(0, field.shape[2], BLOCK, BLOCK)]
    n_at_once = ITEMS_AT_ONCE if is_known(field) else ITEMS_OF_GPU
    for corners, row_centres, column_centres, rows, columns in zip(
        *(part.split(n_at_once) for part in items[:3]), *(part.split(n_at_once, 1) for part in items[3:]), strict=True
    ):
        y = ((corners[:, :1] + row_centres)[..., None] + span).clamp(0, height - 1)
        x = ((corners[:, 1:] + column_centres)[..., None] + span).clamp(0, width - 1)
        places = y[:, :, None, :, None], x[:, None, :, None, :]
        windows = field[v[:, None, None, None], u[:, None, None], :, *places]  # [M, V, U, rows, columns, C]
        windows = windows.permute(0, 1, 5, 3, 2, 4).flatten(4)  # [M, V, C, rows, U columns]
        total = field.new_zeros(())
        for down, across in zip(rows, columns, strict=True):  # the products of which an aperture is the sum
            matrix = (across @ toeplitz.flatten(1)).unflatten(2, (length, BLOCK)).flatten(1, 2)  # [M, U columns, BLOCK]
            of_rows = (windows.flatten(1, 3) @ matrix).unflatten(1, windows.shape[1:4])  # [M, V, C, rows, BLOCK]
            lines = (down @ toeplitz.flatten(1)).unflatten(2, (length, BLOCK)).permute(0, 3, 1, 2).flatten(2)
            stacked = of_rows.permute(0, 1, 3, 2, 4).flatten(3).flatten(1, 2)  # [M, V rows, C BLOCK]
            total = total + (lines @ stacked).unflatten(2, (-1, BLOCK)).transpose(1, 2)
        parts.append(total)
    return torch.cat(parts)


@loops.compiled
def add_items(
    views: NDArray,
    corners: NDArray,
    row_centres: NDArray,
    column_centres: NDArray,
    rows: NDArray,
    columns: NDArray,
    first: int,
    last: int,
    result: NDArray,
) -> None:  # pragma: no cover - compiled
    """Items from `first` to before `last` of the fields of `Items`: result [M, C, BLOCK, BLOCK]."""
    n_rows, n_columns, n_channels, height, width = views.shape
    n_terms, length = len(rows), BLOCK + SPAN - 1
    window = np.zeros((length, length), views.dtype)
    middle = np.zeros((length, LANES), views.dtype)
    for item in range(first, last):
        for c in range(n_channels):
            for v in range(n_rows):
                top = corners[item, 0] + row_centres[item, v] - SPAN // 2
                for k in range(n_terms):
                    # 1. The views of a row, filtered along x and added up.
                    middle[:] = 0
                    for u in range(n_columns):
                        left = corners[item, 1] + column_centres[item, u] - SPAN // 2
                        if top >= 0 and top + length <= height and left >= 0 and left + length <= width:
                            _filter_along_x(
                                views[v, u, c], np.uint64(top), np.uint64(left), columns[k, item, u], middle
                            )
                            continue
                        for y in range(length):
                            for x in range(length):
                                pixels = views[v, u, c, min(max(top + y, 0), height - 1)]
                                window[y, x] = pixels[min(max(left + x, 0), width - 1)]
                        _filter_along_x(window, np.uint64(0), np.uint64(0), columns[k, item, u], middle)
                    # 2. These rows, filtered along y.
                    _filter_along_y(middle, rows[k, item, v], result[item, c])


@loops.compiled
def _filter_along_x(
    pixels: NDArray, top: np.uint64, left: np.uint64, taps: NDArray, total: NDArray
) -> None:  # pragma: no cover - compiled
    """Add filtered pixels from a corner on to a total [rows, LANES], which is read and written once for all taps.

    The corner is unsigned: indices that might be negative would count from the end, and keep the loop from vectors.
    """
    t0, t1, t2, t3, t4, t5, t6, t7 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6], taps[7]
    t8, t9, t10, t11, t12, t13, t14, t15 = taps[8], taps[9], taps[10], taps[11], taps[12], taps[13], taps[14], taps[15]
    for row in range(len(total)):
        y = top + np.uint64(row)
        for lane in range(LANES):
            x = left + np.uint64(lane)
            part0 = (
                t0 * pixels[y, x + np.uint64(0)]
                + t1 * pixels[y, x + np.uint64(1)]
                + t2 * pixels[y, x + np.uint64(2)]
                + t3 * pixels[y, x + np.uint64(3)]
            )
            part1 = (
                t4 * pixels[y, x + np.uint64(4)]
                + t5 * pixels[y, x + np.uint64(5)]
                + t6 * pixels[y, x + np.uint64(6)]
                + t7 * pixels[y, x + np.uint64(7)]
            )
            part2 = (
                t8 * pixels[y, x + np.uint64(8)]
                + t9 * pixels[y, x + np.uint64(9)]
                + t10 * pixels[y, x + np.uint64(10)]
                + t11 * pixels[y, x + np.uint64(11)]
            )
            part3 = (
                t12 * pixels[y, x + np.uint64(12)]
                + t13 * pixels[y, x + np.uint64(13)]
                + t14 * pixels[y, x + np.uint64(14)]
                + t15 * pixels[y, x + np.uint64(15)]
            )
            total[row, lane] += (part0 + part1) + (part2 + part3)


@loops.compiled
def _filter_along_y(rows: NDArray, taps: NDArray, total: NDArray) -> None:  # pragma: no cover - compiled
    """Add filtered rows [rows, LANES] to a total [BLOCK, LANES]."""
    t0, t1, t2, t3, t4, t5, t6, t7 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6], taps[7]
    t8, t9, t10, t11, t12, t13, t14, t15 = taps[8], taps[9], taps[10], taps[11], taps[12], taps[13], taps[14], taps[15]
    for row in range(len(total)):
        for lane in range(LANES):
            part0 = (
                t0 * rows[row + 0, lane]
                + t1 * rows[row + 1, lane]
                + t2 * rows[row + 2, lane]
                + t3 * rows[row + 3, lane]
            )
            part1 = (
                t4 * rows[row + 4, lane]
                + t5 * rows[row + 5, lane]
                + t6 * rows[row + 6, lane]
                + t7 * rows[row + 7, lane]
            )
            part2 = (
                t8 * rows[row + 8, lane]
                + t9 * rows[row + 9, lane]
                + t10 * rows[row + 10, lane]
                + t11 * rows[row + 11, lane]
            )
            part3 = (
                t12 * rows[row + 12, lane]
                + t13 * rows[row + 13, lane]
                + t14 * rows[row + 14, lane]
                + t15 * rows[row + 15, lane]
            )
            total[row, lane] += (part0 + part1) + (part2 + part3)
