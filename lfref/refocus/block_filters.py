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
from lfref.functional.devices import is_known, length_within, on_device
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
APART = 8
"""Largest distance, in pixels, between what two planes of a block read of a view, if a loop filters both together."""
REACH = (8.0, 10.0)
"""Distances in pixels between the first and the last pixel that a filter must read: from the first one on it fades out,
from the second one on it is not used."""
FLOOR = 0.05
"""Least power of a pixel, of the mean: what is smooth has hardly any disparity."""
MOST_DISPARITIES = 1024
"""Largest number of disparities that the priors of a field have: beyond it their distance grows."""
FILTERS_AT_ONCE, ITEMS_AT_ONCE, ITEMS_OF_GPU = 3584, 32, 16384
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
    n_planes, n_blocks = nearness.shape
    parts = (torch.arange(n_blocks, device=field.device),)
    if is_known(nearness):
        some = (nearness > 0).any(0).nonzero()[:, 0]
        parts = some.split(max(1, FILTERS_AT_ONCE // max(lengths)))
    pictures = field.new_zeros(n_planes * n_blocks, n_channels, BLOCK, BLOCK)
    for blocks in parts:
        # Block by block: its views stay in the processor's caches.
        if is_known(nearness) or torch.compiler.is_exporting():
            b, n = (nearness[:, blocks] > 0).T.nonzero().unbind(1)
        else:  # all planes: the host would wait for the number of those that are near
            item = torch.arange(n_blocks * n_planes, device=field.device)
            b, n = item // n_planes, item % n_planes
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
        block_row = index // counts[1]
        corners = BLOCK * torch.stack([block_row, index - block_row * counts[1]], 1)
        items = Items(corners, *centres, *(of_axis.to(field.dtype) for of_axis in taps))
        pictures[n * n_blocks + index] = filtered(field, items)
    grid = pictures.reshape(n_planes, *counts, n_channels, BLOCK, BLOCK).permute(0, 3, 1, 4, 2, 5)
    stack = grid.reshape(n_planes, n_channels, BLOCK * counts[0], BLOCK * counts[1])
    spread = nearness.to(field).reshape(n_planes, 1, *counts)
    spread = spread.repeat_interleave(BLOCK, 2).repeat_interleave(BLOCK, 3)
    return stack.narrow(2, 0, height).narrow(3, 0, width), spread.narrow(2, 0, height).narrow(3, 0, width)


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
    around, weights = (_windows(image.detach().double()) for image in (disparity, power))
    low, high = around.amin(1), around.amax(1)
    first = torch.minimum(low.amin(0), prior.disparities[0])
    last = torch.maximum(high.amax(0), torch.where(prior.shares > 0, prior.disparities, first).amax(0))
    step = ((last - first) / MOST_DISPARITIES).clamp(min=STEP)
    most = min(math.ceil(widest / STEP), MOST_DISPARITIES) + 4
    n_disparities = length_within(((last - first) / step).ceil() + 4, most)
    disparities = first + step * (torch.arange(n_disparities, dtype=torch.float64, device=disparity.device) - 1)
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


def _windows(image: Tensor) -> Tensor:
    """The pixels in and around each block of an image [H, W], [B, pixels]; the outermost ones repeat."""
    for length in image.shape:
        starts = BLOCK * torch.arange((length + BLOCK - 1) // BLOCK, device=image.device)
        pixels = starts[:, None] + torch.arange(BLOCK + 2 * AROUND, device=image.device) - AROUND
        image = image.index_select(0, pixels.clamp(0, length - 1).flatten()).unflatten(0, pixels.shape)
        image = image.movedim(2, 0)  # the other axis
    return image.flatten(2).flatten(0, 1)


def _steepness(central: Tensor) -> Tensor:
    """Power of the detail of each pixel of the middle view [H, W], with a floor, [H, W]."""
    power = neighbours.box_mean(cost_volume.steepness(central)[None, None], 3)[0, 0]
    return power + FLOOR * power.mean() + torch.finfo(power.dtype).tiny


def _counted(values: Tensor, weights: Tensor, disparities: Tensor) -> Tensor:
    """Weights [B, P] of values [B, P], each shared by its two neighbours among even disparities [D], [B, D]."""
    places = (values - disparities[0]) / (disparities[1] - disparities[0])
    under = places.floor().long().clamp(0, disparities.shape[0] - 2)
    counted = values.new_zeros(values.shape[0], disparities.shape[0])
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
    if torch.compiler.is_exporting():
        return _some_by_torch(field, items)
    n_at_once = ITEMS_AT_ONCE if is_known(field) else ITEMS_OF_GPU
    parts = zip(*(of.split(n_at_once) for of in items[:3]), *(of.split(n_at_once, 1) for of in items[3:]), strict=True)
    none = field.new_zeros(0, field.shape[2], BLOCK, BLOCK)
    return torch.cat([none, *(_some_by_torch(field, Items(*part)) for part in parts)])


def _some_by_torch(field: Tensor, items: Items) -> Tensor:
    """Products with Toeplitz matrices of the taps, a row of views at a time."""
    device, (n_rows, n_columns, n_channels, height, width) = field.device, field.shape
    n_read = BLOCK + SPAN - 1
    span = torch.arange(n_read, device=device)
    pixel, tap, view = (torch.arange(n, device=device) for n in (BLOCK, SPAN, n_columns))
    toeplitz = (pixel[:, None] + tap[:, None, None] == span).to(field).flatten(1)  # [T, BLOCK read]
    rows, columns = ((taps @ toeplitz).unflatten(-1, (BLOCK, n_read)) for taps in (items.rows, items.columns))
    columns = columns.transpose(2, 3).flatten(3)  # [terms, M, BLOCK, U read]; rows: [terms, M, V, BLOCK, read]
    # First pixels to be read.
    top = items.corners[:, :1] + items.row_centres - SPAN // 2
    left = items.corners[:, 1:] + items.column_centres - SPAN // 2
    x = (left[..., None] + span).clamp(0, width - 1) + (height * width) * view[:, None]  # [M, U, columns]
    n_items, total = x.shape[0], field.new_zeros(())
    for v in range(n_rows):
        y = width * (top[:, v, None] + span).clamp(0, height - 1)
        light = field[v].permute(0, 2, 3, 1).reshape(-1, n_channels)
        windows = light.index_select(0, (x[..., None] + y[:, None, None]).flatten())
        windows = windows.reshape(n_items, n_columns * n_read, n_read * n_channels)
        for down, across in zip(rows, columns, strict=True):  # the products of which an aperture is the sum
            of_rows = (across @ windows).reshape(n_items, BLOCK, n_read, n_channels).permute(0, 2, 3, 1).flatten(2)
            total = total + down[:, v] @ of_rows
    return total.reshape(n_items, BLOCK, n_channels, BLOCK).transpose(1, 2)


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
    n_rows, n_columns, n_channels = views.shape[:3]
    n_terms, length = len(rows), BLOCK + SPAN - 1
    side = length + 2 * APART
    window = np.zeros((side, side), views.dtype)
    middles = np.zeros((last - first, length, LANES), views.dtype)
    while first < last:
        # Items of one block read nearly the same pixels of a view, which are copied to the cache once.
        end = first + 1
        while (
            end < last
            and (corners[end] == corners[first]).all()
            and np.abs(row_centres[end] - row_centres[first]).max() <= APART
            and np.abs(column_centres[end] - column_centres[first]).max() <= APART
        ):
            end += 1
        for c in range(n_channels):
            for v in range(n_rows):
                top = corners[first, 0] + row_centres[first, v] - SPAN // 2 - APART
                for k in range(n_terms):
                    # 1. The views of a row, filtered along x and added up.
                    middles[: end - first] = 0
                    for u in range(n_columns):
                        left = corners[first, 1] + column_centres[first, u] - SPAN // 2 - APART
                        _read_window(views[v, u, c], top, left, window)
                        for item in range(first, end):
                            _filter_along_x(
                                window,
                                np.uint64(APART + row_centres[item, v] - row_centres[first, v]),
                                np.uint64(APART + column_centres[item, u] - column_centres[first, u]),
                                columns[k, item, u],
                                middles[item - first],
                            )
                    # 2. These rows, filtered along y.
                    for item in range(first, end):
                        _filter_along_y(middles[item - first], rows[k, item, v], result[item, c])
        first = end


@loops.compiled
def _read_window(pixels: NDArray, top: int, left: int, window: NDArray) -> None:  # pragma: no cover - compiled
    """Copy the pixels from a corner on; beyond the border the outermost ones repeat."""
    side, (height, width) = len(window), pixels.shape
    is_inside = left >= 0 and left + side <= width
    for y in range(side):
        row, line = pixels[min(max(top + y, 0), height - 1)], window[y]
        if is_inside:
            line[:] = row[left : left + side]
            continue
        for x in range(side):
            line[x] = row[min(max(left + x, 0), width - 1)]


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
