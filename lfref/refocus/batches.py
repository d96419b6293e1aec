"""What all operators do to their arguments: any batch dimensions, checked weights, a type that can be computed in."""

from collections.abc import Callable

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.lightfield import check_views


def checked_weights(weights: Tensor | None, grid: tuple[int, int]) -> Tensor:
    """The aperture as weights that sum to 1.

    Args:
        weights: Weight of each view, finite and >= 0, [V, U]; None weighs all views alike.
        grid: Number of view rows and columns (V, U).

    Returns:
        Normalised weights, float64, CPU, [V, U].

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
    return values / values.sum()


def over_batches(views: Tensor, refocus: Callable[[Tensor], Tensor]) -> Tensor:
    """Run an operator over any batch dimensions, in float32 or float64, and hand back the input's type.

    Args:
        views: Light fields, floating point, [..., V, U, C, H, W].
        refocus: Operator from [B, V, U, C, H, W] to [B, N, C, H, W].

    Returns:
        Stacks, [..., N, C, H, W].
    """
    check_views(views)
    working = views.dtype if views.dtype in (torch.float32, torch.float64) else torch.float32
    stack = refocus(views.reshape(-1, *views.shape[-5:]).to(working))
    return stack.reshape(*views.shape[:-5], *stack.shape[1:]).to(views.dtype)
