"""What all operators do to their arguments: any batch dimensions, checked weights and cameras, the type and code that
compute.

Positions of cameras become what a shift separates into: lines of views, each at one height. An even grid has its rows,
all with the same columns. Cameras elsewhere are lines if each row of them stands at one height; otherwise every view is
a line of its own.
Letters: `v u` camera position downwards and to the right, in view steps; `R` lines, `M` views of each.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.functional.devices import is_known, on_device, on_host
from lfref.geometry import Slopes
from lfref.lightfield import check_axes

FULL_SCALE = {torch.uint8: 255, torch.uint16: 65535}
"""Integer types that views may have, and the integer that is radiance 1."""


def is_compiled(*tensors: Tensor) -> bool:
    """Whether compiled loops can serve for tensors; else PyTorch has to."""
    return tensors[0].device.type == "cpu" and all(map(is_plain, tensors))


def is_plain(tensor: Tensor) -> bool:
    """Whether code outside PyTorch may read these numbers: not while traced, nor where derivatives are needed."""
    is_differentiated = tensor.requires_grad and torch.is_grad_enabled()
    if torch.compiler.is_compiling() or type(tensor) is not Tensor or is_differentiated:
        return False
    try:
        tensor.data_ptr()
    except RuntimeError:  # what `torch.func` transforms wrap has no memory of its own
        return False
    return torch.autograd.forward_ad.unpack_dual(tensor).tangent is None


@on_host
def checked_weights(weights: Tensor | None, grid: tuple[int, int]) -> Tensor:
    """Weights of views, [V, U], scaled to a sum of 1, float64, CPU; None weighs all views alike."""
    if weights is None:
        return torch.full(tuple(grid), 1 / (grid[0] * grid[1]), dtype=torch.float64)
    values = torch.as_tensor(weights, dtype=torch.float64, device="cpu").detach()
    is_usable = bool(values.isfinite().all()) and bool((values >= 0).all()) and float(values.sum()) > 0
    if tuple(values.shape) != tuple(grid) or not is_usable:
        expected = f"weights must be finite, >= 0 and not all zero, one for each view, {list(grid)}"
        raise InputError(expected, got=f"shape {list(values.shape)}, sum {float(values.sum()):g}")
    # Divided by the largest first: the sum of huge weights is infinite.
    values = values / values.max()
    return values / values.sum()


@on_host
def symmetric_weights(weights: Tensor | None, grid: tuple[int, int]) -> Tensor:
    """As `checked_weights`; an InputError unless they are symmetric about both axes."""
    aperture = checked_weights(weights, grid)
    if not is_symmetric(aperture):
        raise InputError(
            "weights must be symmetric about both axes",
            got="others",
            remedy="use another method, such as shift_and_sum_antialiased",
        )
    return aperture


@on_host
def is_symmetric(weights: Tensor) -> bool:
    """Whether weights [V, U] are symmetric about both axes."""
    return all(torch.allclose(weights, weights.flip(axis)) for axis in (0, 1))


@on_host
def unread(weights: Tensor) -> list[tuple[int, int]]:
    """Row and column of each view of weight 0."""
    return [(v, u) for v, u in (weights == 0).nonzero().tolist()]


def without_unread(views: Tensor, aperture: Tensor) -> Tensor:
    """Views [B, V, U, C, H, W]; those of weight 0 in the aperture [V, U] become black where they may not be finite."""
    black_views = unread(aperture)
    if not black_views or not views.is_floating_point():
        return views
    if is_plain(views) and is_known(views) and all(bool(is_finite(views[:, v, u])) for v, u in black_views):
        return views
    black = on_device(aperture == 0, views.device)
    return views.masked_fill(black[:, :, None, None, None], 0)


def is_finite(views: Tensor) -> Tensor:
    """Whether no sample is NaN or infinite, a bool."""
    if not views.is_floating_point():
        return torch.ones((), dtype=torch.bool, device=views.device)
    # The extremes are NaN if any sample is; `isfinite` of all samples takes two more copies of them.
    return torch.stack(views.detach().aminmax()).isfinite().all()


def check_finite(views: Tensor, remedy: str = "mend the file") -> None:
    """Refuse views that hold NaN or infinity."""
    if not bool(is_finite(views)):
        raise InputError("views must be finite", got="NaN or infinity", remedy=remedy)


def radiance(views: Tensor) -> Tensor:
    """Views of any shape as float32 or float64, integers scaled to [0, 1]; operators call it on parts of a field."""
    if views.dtype in FULL_SCALE:
        return views.to(torch.float32).div_(FULL_SCALE[views.dtype])
    return views.to(working_dtype(views.dtype))


def working_dtype(dtype: torch.dtype) -> torch.dtype:
    """The type that views of this type are computed in."""
    return torch.float64 if dtype == torch.float64 else torch.float32


def check(views: Tensor) -> None:
    """Raise an InputError unless views are a tensor [..., V, U, C, H, W] of floating point, uint8 or uint16."""
    if not isinstance(views, Tensor):
        raise InputError("views must be a tensor or a LightField", got=type(views), remedy="torch.from_numpy(views)")
    check_axes(views)
    if not (views.is_floating_point() or views.dtype in FULL_SCALE):
        raise InputError(
            "views must be floating point in [0, 1], uint8 or uint16",
            got=views.dtype,
            remedy="scale other integers to [0, 1]",
        )


def flattened(views: Tensor) -> Tensor:
    """Checked views [..., V, U, C, H, W] as [B, V, U, C, H, W], in their own type: `radiance` converts parts."""
    check(views)
    return views.reshape(-1, *views.shape[-5:])


def restored(stacks: Tensor | list[Tensor], views: Tensor) -> Tensor:
    """Stacks [B, N, C, H, W] of `flattened(views)` with the batch dimensions and `stack_dtype` of the views."""
    if isinstance(stacks, list):  # a single one is not copied
        stacks = torch.stack(stacks) if len(stacks) > 1 else stacks[0][None]
    return stacks.reshape(*views.shape[:-5], *stacks.shape[1:]).to(stack_dtype(views))


def stack_dtype(views: Tensor) -> torch.dtype:
    """The type of stacks of these views: their own, float32 for integers."""
    return views.dtype if views.is_floating_point() else torch.float32


def grid_and_size(views: Tensor) -> tuple[tuple[int, int], tuple[int, int]]:
    """Number of view rows and columns (V, U), height and width (H, W) of views [..., V, U, C, H, W]."""
    n_rows, n_columns, _, height, width = views.shape[-5:]
    return (n_rows, n_columns), (height, width)


class Lines(NamedTuple):
    """Positions of the views from the angular centre, in view steps, float64, CPU."""

    rows: Tensor
    """v of each line, [R]."""
    columns: Tensor
    """u of the views of each line, [R, M]; [1, M] if that of all lines is the same."""

    @property
    def shape(self) -> tuple[int, int]:
        """(R, M), what views [V, U, ...] are reshaped to."""
        return len(self.rows), self.columns.shape[1]

    @property
    @on_host
    def extent(self) -> tuple[float, float]:
        """The even grid (V, U) that reaches as far, which need not be whole."""
        rows, columns = (1 + 2 * float(offsets.abs().max()) for offsets in self)
        return rows, columns


@on_host
def lines(grid: tuple[int, int], positions: Tensor | None = None) -> Lines:
    """The lines of cameras of a grid (V, U), at positions [V, U, 2] or, without any, evenly spaced."""
    if positions is None:
        return Lines(geometry.angular_offsets(grid[0]), geometry.angular_offsets(grid[1])[None])
    v, u = checked_positions(positions, grid).unbind(-1)
    if not bool((v == v[:, :1]).all()):
        return Lines(v.flatten(), u.reshape(-1, 1))
    return Lines(v[:, 0], u[:1] if bool((u == u[:1]).all()) else u)


def even(grid: tuple[int, int]) -> Tensor:
    """(v, u) of each camera of an even grid (V, U) from its centre, in view steps, float64, [V, U, 2]."""
    return torch.stack(torch.meshgrid(*map(geometry.angular_offsets, grid), indexing="ij"), -1)


def checked_positions(positions: Tensor, grid: tuple[int, int]) -> Tensor:
    """The positions as float64 on the CPU, [V, U, 2]."""
    values = torch.as_tensor(positions, dtype=torch.float64, device="cpu").detach()
    if tuple(values.shape) != (*grid, 2) or not bool(values.isfinite().all()):
        expected = f"positions must be finite, (v, u) of each view in view steps, {[*grid, 2]}"
        raise InputError(expected, got=f"shape {list(values.shape)}")
    return values


def checked_slopes(slopes: Slopes, grid: tuple[int, int], size: tuple[int, int], positions: Tensor | None) -> Tensor:
    """As `geometry.checked_slopes`, for cameras anywhere."""
    if torch.compiler.is_exporting() and isinstance(slopes, Tensor):
        return slopes
    return geometry.checked_slopes(slopes, lines(grid, positions).extent, size)
