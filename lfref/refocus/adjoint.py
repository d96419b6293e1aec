"""The adjoint of a linear refocusing operator: stacks back to views, each sample to the views that it was read from.

`<A views, stack> = <views, A* stack>`, as iterative reconstruction needs it: a light field from its focal stack by
least squares (`views += step * A*(measured - A views)`), or the normal equations of any fit to a stack.
It stands alone for users of solvers: nothing else in lfref calls it.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from lfref.errors import InputError

EXPECTED = "an operator must be linear to have an adjoint"


def adjoint(operator: Callable[[Tensor], Tensor], stack: Tensor, like: Tensor) -> Tensor:
    """Apply the adjoint of a linear operator to stacks, by one reverse pass at zero views.

    The result is checked: `A` of it must have the same product with the stack as it has with itself.

    Args:
        operator: Linear, views [..., V, U, C, H, W] -> stack [..., N, C, H, W]; slopes and options already bound.
        stack: Stacks of the shape that the operator returns for the views, [..., N, C, H, W].
        like: Any tensor with the shape and type of the views, [..., V, U, C, H, W]; of device `meta` (without data)
            the result is on the device of the stack.

    Returns:
        Views, type (float32 for integers) and device of `like`, [..., V, U, C, H, W]; differentiable in the stack.

    Raises:
        InputError: Another shape of stack than the operator returns, or an operator that is not linear, for example
            one that estimates disparities from the views.

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
    if forward.shape != stack.shape:
        raise InputError(
            f"a stack must be {list(forward.shape)}, as the operator returns for views {list(like.shape)}",
            got=f"shape {list(stack.shape)}",
        )
    if not forward.requires_grad:
        raise InputError(EXPECTED, got="one without gradients")
    if bool(forward.any()):
        raise InputError(EXPECTED, got="light where all views are black")
    back = torch.autograd.grad(forward, views, stack.to(forward), create_graph=stack.requires_grad)[0]
    with torch.no_grad():
        there, here = _product(operator(back.detach()), stack), _product(back, back)
    if abs(there - here) > math.sqrt(torch.finfo(dtype).eps) * here:
        got = f"one that is not: <A A* stack, stack> / <A* stack, A* stack> is {there / here:.4g} instead of 1"
        raise InputError(EXPECTED, got=got, remedy="bind what it would estimate from the views, such as disparities")
    return back


def _product(first: Tensor, second: Tensor) -> float:
    """The inner product of two tensors, without gradients."""
    return float((first.detach().double() * second.detach().to(first.device).double()).sum())
