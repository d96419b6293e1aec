"""What an operator says of itself, how it takes samples that count less than others; and its adjoint.

The adjoint takes stacks back to views, each sample to the views that it was read from: `<A views, stack> = <views, A*
stack>`. Iterative reconstruction needs it: a light field from its focal stack by least squares (`views += step *
A*(measured - A views)`). It stands alone for users of solvers: nothing else in lfref calls it.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, TypeVar

import torch
from torch import Tensor

Function = TypeVar("Function", bound=Callable[..., Any])
Reading = Literal["sums", "compares", "predicts"]


class Traits(NamedTuple):
    """What an operator (views, slopes, weights=, positions=) -> stack does with the views."""

    reads: Reading = "sums"
    """`sums`: linear in the views, so that weighted samples are summed and divided by the sum of their weights.
    `compares`: it looks for what views have in common, which weighted views would mislead: they are filled first.
    `predicts`: it estimates what the whole aperture records, so that missing views are predicted for it too."""
    symmetric: bool = False
    """Whether weights of views must be symmetric about both axes."""


def traits(operator: Callable[..., Any]) -> Traits:
    """The traits of an operator, with options bound to it or without; a function without any sums."""
    own: Traits = getattr(getattr(operator, "func", operator), "traits", Traits())
    return own


def has_traits(reads: Reading, symmetric: bool = False) -> Callable[[Function], Function]:
    """A decorator that gives an operator these traits."""

    def decorate(function: Function) -> Function:
        function.traits = Traits(reads, symmetric)  # type: ignore[attr-defined]
        return function

    return decorate


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
