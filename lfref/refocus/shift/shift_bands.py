"""Shift-and-sum as products with banded matrices: on any device, differentiable, and in files.

A shifted view is read at x + shift by a few taps, so that along one axis a shift is a matrix with a band. A block of
`BLOCK` outputs reads the same few samples of each view: they are gathered, and multiplied by a small matrix of the
taps. All views of a line are one product (`across`), and the lines are another (`down`). Devices and runtimes gather
long rows fast and single samples slowly, so the axis of the shift comes first.
Letters: `B` light fields, `R M` lines of views and views in each, `N` planes, `C H W` channel, pixel row and column,
`L` samples along an axis, `K` blocks, `T` taps, `J` samples that a block reads of a view.
"""

import torch
from torch import Tensor

from lfref.functional.devices import is_known, on_device, on_host
from lfref.refocus import batches, footprint, sampling
from lfref.refocus.sampling import Border, Interpolation
from lfref.refocus.shift.shifts import Shifts

BLOCK = 8
"""Outputs of one product; 16 took 1.1 times as long (ONNX Runtime, 7x7 views of 375x540 pixels, 16 planes)."""
AT_ONCE = 1 << 28
"""Samples that are gathered at once, where planes need not share a processor's cache: 1 GB."""

Bands = tuple[Tensor, Tensor]
"""Samples that the blocks read of each view, [..., K, J], and what each output takes of them, [..., K, BLOCK, J]."""


def sum_by_bands(
    views: Tensor, shifts: Shifts, aperture: Tensor, interpolation: Interpolation, border: Border
) -> Tensor:
    """Sums [B, N, C, H, W] of views [B, R, M, C, H, W], shifted and weighted by an aperture [R, M] of sum 1."""
    if torch.compiler.is_exporting():
        sums = _sum(views, shifts.rows, shifts.columns, aperture, interpolation, border)
        return finished(sums, shifts, aperture, border)
    gathered = (views[:, 0].numel() * (BLOCK + 3)) // BLOCK
    # One plane at a time stays in a processor's caches.
    n_at_once = 1 if is_known(views) else max(1, AT_ONCE // gathered)
    parts = [
        _sum(views, rows, columns, aperture, interpolation, border)
        for rows, columns in zip(shifts.rows.split(n_at_once), shifts.columns.split(n_at_once), strict=True)
    ]
    sums = parts[0] if len(parts) == 1 else torch.cat(parts, 1)
    return finished(sums, shifts, aperture, border)


def _sum(
    views: Tensor, rows: Tensor, columns: Tensor, aperture: Tensor, interpolation: Interpolation, border: Border
) -> Tensor:
    """Sums of views at shifts of the lines [N, R] and of the views of each [N, R or 1, M]."""
    n_fields, n_lines, n_views, n_channels, height, width = views.shape
    n_planes, dtype = rows.shape[0], batches.working_dtype(views.dtype)
    samples, taps = _bands(columns, width, interpolation, border, dtype)
    lines, down = _bands(rows, height, interpolation, border, dtype)
    first_of_view = width * torch.arange(n_views, device=views.device)[:, None, None]
    first_of_plane = height * torch.arange(n_planes, device=views.device)[:, None, None]
    total: Tensor | None = None
    for v in range(n_lines):
        # One line of views at a time: only it is held as floating point.
        light = batches.radiance(views[:, v]).permute(1, 4, 0, 2, 3)  # M, W, B, C, H
        own = v if samples.shape[1] > 1 else 0
        across = taps[:, own] * aperture[v][:, None, None, None]
        sums = _products(
            light.reshape(n_views * width, n_fields * n_channels * height),
            (samples[:, own] + first_of_view).transpose(1, 2),
            across.permute(0, 2, 3, 1, 4),
        )
        padded = sums.shape[1]
        turned = sums.reshape(n_planes, padded, n_fields * n_channels, height).permute(0, 3, 1, 2)
        turned = turned.reshape(n_planes * height, padded * n_fields * n_channels)
        part = _products(turned, (lines[:, v] + first_of_plane)[:, :, None], down[:, v, :, :, None])
        total = part if total is None else total + part
    assert total is not None
    whole = total.reshape(n_planes, total.shape[1], -1, n_fields, n_channels)
    # `narrow` has exactly this length, while a slice would have what the exporter cannot compare with it.
    return whole.narrow(1, 0, height).narrow(2, 0, width).permute(3, 0, 4, 1, 2)


def moved_by_bands(
    images: Tensor, down: Tensor, across: Tensor, interpolation: Interpolation, border: Border
) -> Tensor:
    """Images [K, H, W] read at shifts of their own, [N, K] along each axis: [N, K, H, W]."""
    n_images, height, width = images.shape
    for shifts in (across, down):
        # The axis of the shift comes first: columns, then rows.
        n_shifts, length = shifts.shape[0], images.shape[-1]
        samples, taps = _bands(shifts, length, interpolation, border, images.dtype)
        n_own = images.shape[0]
        first = length * torch.arange(n_own, device=images.device).reshape(-1, n_images)
        data = images.mT.reshape(n_own * length, images.shape[1])
        index = (samples + first[..., None, None]).flatten(0, 1)
        read = _products(data, index, taps.flatten(0, 1)).narrow(1, 0, length)
        images = read.reshape(n_shifts * n_images, length, -1)  # the other axis is last now
    return images.reshape(-1, n_images, height, width)


def _bands(shifts: Tensor, length: int, interpolation: Interpolation, border: Border, dtype: torch.dtype) -> Bands:
    """The bands of an axis of some length, for shifts [...] in pixels."""
    whole = shifts.floor()
    taps = torch.stack(interpolation.weights(shifts - whole), -1)  # [..., T]
    places = on_device(_places(taps.shape[-1]), shifts.device)
    n_samples = places.shape[1] // BLOCK
    matrix = (taps @ places).reshape(*shifts.shape, 1, BLOCK, n_samples)
    n_blocks = (length + BLOCK - 1) // BLOCK
    sample, output = (
        torch.arange(-before, BLOCK * n_blocks - before, BLOCK, device=shifts.device)[:, None]
        + torch.arange(n, device=shifts.device)
        for n, before in ((n_samples, interpolation.before), (BLOCK, 0))
    )
    index, exists = border.tap(whole.long()[..., None, None] + sample, shifts.new_ones(()), length)
    if border.counts_only_samples:
        matrix = matrix * sampling.is_sampled(shifts[..., None, None], output, length)[..., None]
    elif exists.ndim:
        matrix = matrix * exists[..., None, :]
    return index, matrix.expand(*shifts.shape, n_blocks, BLOCK, n_samples).to(dtype)


@on_host
def _places(n_taps: int) -> Tensor:
    """1 where a tap of an output is that of a sample of its block, else 0, [T, BLOCK J]."""
    output, tap, sample = (torch.arange(n) for n in (BLOCK, n_taps, BLOCK + n_taps - 1))
    return (output[:, None] + tap[:, None, None] == sample).double().flatten(1)


def _products(data: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """Sums of rows of `data` [S, Q], block by block, [N, K * BLOCK, Q].

    `index` [N, K, ..., J] are the rows that each block reads, `weights` [N, K, BLOCK, ..., J] those of each in its
    sums.
    """
    n_planes, n_blocks = weights.shape[:2]
    matrix = weights.reshape(n_planes * n_blocks, BLOCK, -1)
    rows = data.index_select(0, index.reshape(-1)).reshape(n_planes * n_blocks, matrix.shape[2], data.shape[1])
    return (matrix @ rows).reshape(n_planes, n_blocks * BLOCK, data.shape[1])


def finished(sums: Tensor, shifts: Shifts, aperture: Tensor, border: Border) -> Tensor:
    """Sums [B, N, C, H, W] blurred by the boxes of their planes, over the weight of the samples that count."""
    if shifts.boxes is not None:
        sums = footprint.boxed(sums, shifts.boxes, border)
    if not border.counts_only_samples:
        return sums
    covered, blurred = shifts.coverage(aperture.to(sums), (sums.shape[-2], sums.shape[-1]), border)
    return sums * footprint.inverse(covered, blurred)[:, None]
