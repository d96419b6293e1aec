"""Shift-and-sum on a GPU as one Triton kernel: each tile of the result is summed over all views for every plane.

A tile's planes read nearly the same samples of the views, so the field comes from memory about once, and from the
caches after that. Boxes are left to PyTorch. It is kept for GPUs, where PyTorch's operations would read the field once
for every plane and tap. Tests run it on a GPU, and in Triton's interpreter where there is none.
A file of its own, since Triton is optional.
Letters: `n` plane, `v u` view row and column, `m` tap, `y x` pixel row and column.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

from lfref.refocus import batches
from lfref.refocus.shift import shift_torch
from lfref.refocus.shift.shift_plan import Plan

TILE = (8, 64)
"""Rows and columns of the result that one program sums."""


def shift_and_sum(views: Tensor, plan: Plan) -> Tensor:
    """The sums of the shifted views, over the weight of those that count.

    Args:
        views: Light fields on a GPU, floating point, uint8 or uint16, any strides, [B, V, U, C, H, W].
        plan: What is to be summed, by an interpolation of few taps, all rows of views at the same columns.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W].
    """
    n_batch, n_rows, n_columns, n_channels, height, width = views.shape
    working = batches.working_dtype(views.dtype)
    stack = views.new_empty((n_batch, len(plan.planes), n_channels, height, width), dtype=working)
    aperture, tables = torch.tensor(plan.aperture, dtype=working, device=views.device), []
    for axis in (0, 1):
        # Offsets and weights of the taps, [N, views, M]; first and one-past-last output sample that each view counts
        # for, [N, views, 2]; the sample at each position from -reach to length + reach, -1: black.
        shifts = [plane.columns[0] if axis else plane.rows for plane in plan.planes]
        taps = torch.tensor([[plan.interpolation.taps(each) for each in own] for own in shifts], dtype=torch.float64)
        spans = torch.tensor([[plan.span(each, axis) for each in own] for own in shifts])
        offsets, weights = (part.contiguous() for part in taps.unbind(-1))
        indices = plan.border.indices(plan.reach, plan.size[axis])
        tables += [offsets.to(stack.device, torch.int32), weights.to(stack)]
        tables += [table.to(stack.device, torch.int32) for table in (spans, indices)]
    grid = (triton.cdiv(width, TILE[1]), triton.cdiv(height, TILE[0]), n_batch * n_channels)
    _sum_tile[grid](
        views, *views.stride(), stack, aperture, *tables, 1 / batches.FULL_SCALE.get(views.dtype, 1),
        height, width, plan.reach, n_channels, len(plan.planes), n_rows, n_columns,
        n_taps=tables[0].shape[-1], counts_only_samples=plan.border.counts_only_samples and not plan.blurs,
        n_tile_rows=TILE[0], n_tile_columns=TILE[1],
    )  # fmt: skip
    if not plan.blurs:
        return stack
    planes = zip(stack.unbind(1), plan.planes, strict=True)
    return torch.stack([shift_torch.finished(*plane, plan) for plane in planes], dim=1)


@triton.jit
def _sum_tile(  # type: ignore[no-untyped-def]
    views, stride_b, stride_v, stride_u, stride_c, stride_y, stride_x, stack, aperture,
    row_offsets, row_weights, row_spans, row_beyond, column_offsets, column_weights, column_spans, column_beyond,
    unit, height, width, reach, n_channels, n_planes, n_rows, n_columns,
    n_taps: tl.constexpr, counts_only_samples: tl.constexpr, n_tile_rows: tl.constexpr, n_tile_columns: tl.constexpr,
):  # fmt: skip
    """One tile of one channel, every plane."""
    # Offsets of memory are 64-bit throughout: the samples of a field may lie more than 2^31 apart.
    b, c = tl.program_id(2) // n_channels, tl.program_id(2) % n_channels
    y = (tl.program_id(1) * n_tile_rows + tl.arange(0, n_tile_rows))[:, None]
    x = (tl.program_id(0) * n_tile_columns + tl.arange(0, n_tile_columns))[None, :]
    inside = (y < height) & (x < width)
    image = views + b.to(tl.int64) * stride_b + c.to(tl.int64) * stride_c
    for n in range(n_planes):
        total = tl.zeros((n_tile_rows, n_tile_columns), stack.dtype.element_ty)
        covered = tl.zeros((n_tile_rows, n_tile_columns), stack.dtype.element_ty)
        for v in range(n_rows):
            nv = n * n_rows + v
            row_counts = inside & (y >= tl.load(row_spans + 2 * nv)) & (y < tl.load(row_spans + 2 * nv + 1))
            for u in range(n_columns):
                nu = n * n_columns + u
                weight = tl.load(aperture + v * n_columns + u)
                counts = row_counts & (x >= tl.load(column_spans + 2 * nu)) & (x < tl.load(column_spans + 2 * nu + 1))
                covered += tl.where(counts, weight, 0.0)
                view = image + tl.cast(v, tl.int64) * stride_v + tl.cast(u, tl.int64) * stride_u
                for m in tl.static_range(n_taps * n_taps):
                    row_tap, column_tap = nv * n_taps + m // n_taps, nu * n_taps + m % n_taps
                    share = tl.load(row_weights + row_tap) * tl.load(column_weights + column_tap) * weight
                    if share != 0:  # a tap of weight 0 must not touch its sample: 0 * inf is NaN
                        y_place = y + reach + tl.load(row_offsets + row_tap)
                        x_place = x + reach + tl.load(column_offsets + column_tap)
                        y_source = tl.load(row_beyond + y_place, mask=counts, other=-1)
                        x_source = tl.load(column_beyond + x_place, mask=counts, other=-1)
                        exists = (y_source >= 0) & (x_source >= 0)
                        place = y_source.to(tl.int64) * stride_y + x_source.to(tl.int64) * stride_x
                        sample = tl.load(view + place, mask=exists, other=0)
                        total += share * sample.to(stack.dtype.element_ty)
        if counts_only_samples:
            total = tl.where(covered > 0, total / tl.where(covered > 0, covered, 1.0), 0.0)
        plane = (b.to(tl.int64) * n_planes + n) * n_channels + c
        tl.store(stack + (plane * height + y) * width + x, total * unit, mask=inside)
