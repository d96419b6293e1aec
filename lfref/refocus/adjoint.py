"""The adjoint of a linear refocusing operator: stacks back to views, each sample to the views that it was read from.

`<A views, stack> = <views, A* stack>`, as iterative reconstruction needs it: a light field from its focal stack by
least squares (`views += step * A*(measured - A views)`), or the normal equations of any fit to a stack.
It stands alone for users of solvers: nothing else in lfref calls it.
"""

from collections.abc import Callable

import torch
from torch import Tensor


def adjoint(operator: Callable[[Tensor], Tensor], stack: Tensor, like: Tensor) -> Tensor:
    """Apply the adjoint of a linear operator to stacks, by one reverse pass at zero views.

    Args:
        operator: Linear, views [..., V, U, C, H, W] -> stack [..., N, C, H, W]; slopes, options and what it would
            estimate from the views, such as disparities, already bound.
        stack: Stacks of the shape that the operator returns for the views, [..., N, C, H, W].
        like: Any tensor with the shape and type of the views, [..., V, U, C, H, W]; of device `meta` (without data)
            the result is on the device of the stack.

    Returns:
        Views, type (float32 for integers) and device of `like`, [..., V, U, C, H, W]; differentiable in the stack.

    Example:
        >>> views, stack = torch.rand(3, 3, 1, 24, 24), torch.rand(2, 1, 24, 24)
        >>> back = lfref.adjoint(lambda views: lfref.shift_and_sum(views, [0, 0.5]), stack, like=views)
        >>> torch.allclose((lfref.shift_and_sum(views, [0, 0.5]) * stack).sum(), (views * back).sum())
        True
    """
    dtype = like.dtype if like.is_floating_point() else torch.float32
    device = stack.device if like.is_meta else like.device
    with torch.inference_mode(False), torch.enable_grad():
        views = torch.zeros(like.shape, dtype=dtype, device=device, requires_grad=True)
        forward = operator(views)
    return torch.autograd.grad(forward, views, stack.to(forward), create_graph=stack.requires_grad)[0]
