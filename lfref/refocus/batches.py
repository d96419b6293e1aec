"""What all operators do to their arguments: any batch dimensions, checked weights, the type and code that compute."""

import importlib.util

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.lightfield import check_axes

COMPILERS = {"cpu": "numba"} | ({"cuda": "triton"} if importlib.util.find_spec("triton") else {})
"""The compiler that serves each type of device."""
FULL_SCALE = {torch.uint8: 255, torch.uint16: 65535}
"""Integer types that views may have, and the integer that is radiance 1."""


def compiler_for(*tensors: Tensor) -> str | None:
    """`numba` or `triton` where compiled loops can serve for tensors on one device, None where PyTorch has to."""
    return COMPILERS.get(tensors[0].device.type) if all(map(is_plain, tensors)) else None


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


def checked_weights(weights: Tensor | None, grid: tuple[int, int]) -> Tensor:
    """Weights of views, [V, U], scaled to a sum of 1, float64, CPU; None weighs all views alike.

    Raises:
        InputError: Another shape, a weight that is negative or not finite, or weights that sum to zero.
    """
    if weights is None:
        return torch.full(tuple(grid), 1 / (grid[0] * grid[1]), dtype=torch.float64)
    values = torch.as_tensor(weights, dtype=torch.float64, device="cpu").detach()
    if tuple(values.shape) != tuple(grid):
        raise InputError(f"weights must be {list(grid)}, one for each view", got=f"shape {list(values.shape)}")
    if not bool(values.isfinite().all()) or bool((values < 0).any()) or float(values.sum()) <= 0:
        raise InputError("weights must be finite, >= 0 and not all zero", got=f"a sum of {float(values.sum()):g}")
    # Divided by the largest first: the sum of huge weights is infinite.
    values = values / values.max()
    return values / values.sum()


def without_unread(views: Tensor, aperture: Tensor) -> Tensor:
    """Views [B, V, U, C, H, W]; those of weight 0 in the aperture [V, U] become black unless known to be finite."""
    unread = (aperture == 0).nonzero().tolist()
    if not unread or not views.is_floating_point():
        return views
    sums = [views[:, v, u].sum(dtype=working_dtype(views.dtype)) for v, u in unread] if is_plain(views) else []
    if sums and bool(torch.stack(sums).isfinite().all()):
        return views
    return views.masked_fill((aperture == 0).to(views.device)[:, :, None, None, None], 0)


def radiance(views: Tensor) -> Tensor:
    """Views of any shape as float32 or float64, integers scaled to [0, 1].

    Operators call it on a part of the field at a time, so that integer views need no float copy of the whole.
    """
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


def restored(stacks: Tensor, views: Tensor) -> Tensor:
    """Stacks [B, N, C, H, W] of `flattened(views)` with the batch dimensions and `stack_dtype` of the views."""
    return stacks.reshape(*views.shape[:-5], *stacks.shape[1:]).to(stack_dtype(views))


def stack_dtype(views: Tensor) -> torch.dtype:
    """The type of stacks of these views: their own, float32 for integers."""
    return views.dtype if views.is_floating_point() else torch.float32


def grid_and_size(views: Tensor) -> tuple[tuple[int, int], tuple[int, int]]:
    """Number of view rows and columns (V, U), height and width (H, W) of views [..., V, U, C, H, W]."""
    n_rows, n_columns, _, height, width = views.shape[-5:]
    return (n_rows, n_columns), (height, width)
